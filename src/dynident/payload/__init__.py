"""What an arm carries: the ten inertial parameters of a payload, from recordings with and without it."""

from dynident.payload.body import Component, PhysicalBody
from dynident.payload.estimate import Solved, Source, solved
from dynident.payload.evidence import Evidence
from dynident.payload.mount import Mount, mount_of
from dynident.payload.notes import GainsUnknown, NoPayload, NotShown, OtherArm, PayloadOrDrift, SameRecording
from dynident.payload.payload import LoadedLog, Payload, find_payload
from dynident.payload.request import DriveGains, Request

__all__ = [
    "Component",
    "DriveGains",
    "Evidence",
    "GainsUnknown",
    "LoadedLog",
    "Mount",
    "NoPayload",
    "NotShown",
    "OtherArm",
    "Payload",
    "PayloadOrDrift",
    "PhysicalBody",
    "Request",
    "SameRecording",
    "Solved",
    "Source",
    "find_payload",
    "mount_of",
    "solved",
]
