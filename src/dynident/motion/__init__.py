"""From a ``Log`` as recorded to a ``Motion``: smoothing splines, smoothers and filters."""
