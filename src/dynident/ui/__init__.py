"""The page of ``dynident tune``: a server on the loopback, an application of Dash, and its answers.

``guard`` and ``server`` are the way in; ``session`` is what is tuned; ``page`` answers the callbacks that ``app``
registers; ``layout``, ``drawings``, ``readout``, ``parameters`` and ``differences`` make what is seen.
"""

from dynident.ui.serve import serving

__all__ = ["serving"]
