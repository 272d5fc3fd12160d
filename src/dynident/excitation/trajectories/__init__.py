"""Motions as functions of time: pieces from rest to rest within the limits of the joints."""
