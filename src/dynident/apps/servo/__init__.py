"""Servo."""
