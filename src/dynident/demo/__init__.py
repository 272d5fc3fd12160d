"""An arm to try things with: a robot file, two recordings of it, and what is true of it."""

from __future__ import annotations

from dynident.demo.comparison import Compared, Comparison, compare_with_truth
from dynident.demo.shipped import demo_files
from dynident.demo.truth import DemoTruth, demo_truth

__all__ = ["Compared", "Comparison", "DemoTruth", "compare_with_truth", "demo_files", "demo_truth"]
