"""The identified model as files for other programs."""

from dynident.project.export.formats import Mjcf, Numpy, PinocchioArm, Urdf, Yaml
from dynident.project.export.identified import IdentifiedModel, Servo
from dynident.project.export.numpy_module import identified_module
from dynident.project.export.proof import export, export_files, exports, prove, random_states, relocate_urdf, spread
from dynident.project.export.robot_files import (
    check_payload_link,
    identified_mjcf,
    identified_urdf,
    strip_to_joints,
    with_payload_link,
)
from dynident.project.export.servos import identified_model
from dynident.project.export.written import Export, Exporter, ExportText, FileError, Proof
