"""What an arm carries, identified from recordings with the payload."""

from dynident.apps.payload.body import (
    Component,
    GainsUnknown,
    Mount,
    NoPayload,
    NotShown,
    OtherArm,
    PayloadOrDrift,
    PhysicalBody,
    SameRecording,
    mount_of,
)
from dynident.apps.payload.estimate import ArmEvidence, DriveGains, ErrorSource, PayloadRequest
from dynident.apps.payload.payload import LoadedLog, Payload, find_payload
