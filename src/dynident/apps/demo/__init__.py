"""An arm that comes with dynident, whose truth is known."""

from dynident.apps.demo.arm import DemoTruth, demo_truth
from dynident.apps.demo.files import ComparedValue, Comparison, compare_with_truth, demo_files
from dynident.apps.demo.servo_arm import TRUE_DELAY, TRUE_VALUES, servo_files
