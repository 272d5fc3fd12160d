"""A robot that is watched: recursive least squares, derivatives with a fixed lag, detection of changes."""
