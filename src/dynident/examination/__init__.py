"""What is wrong with a robot file, with recordings, or between the two, before any parameter is identified."""

from dynident.examination.examine import Examination, examine
from dynident.examination.motion import Excitation, Rank
from dynident.examination.robot import LinkFacts, examine_robot, link_facts
from dynident.examination.torque import Agreement

__all__ = ["Agreement", "Examination", "Excitation", "LinkFacts", "Rank", "examine", "examine_robot", "link_facts"]
