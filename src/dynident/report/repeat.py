"""What repeats a run, in a report: the configuration, the hashes of what was read, versions and settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.io.project import FILE, HASH, HASH_OF, ORIGIN
from dynident.report.page import Code, Fold, PageBlock, PageSection, pairs
from dynident.report.wording import settings_of

if TYPE_CHECKING:
    from dynident.identification import Identification

__all__ = ["repeat_section"]

_LEAD = "The same files, configuration and versions give the same result: apart from the seed below, nothing is drawn."


def repeat_section(identification: Identification) -> PageSection:
    """Return the section with everything needed to repeat the run."""
    settings = settings_of(identification)
    text, origin = settings.pop("configuration", ""), settings.pop(ORIGIN, "")
    hashes = []
    if FILE in settings and HASH in settings:
        hashes.append((settings.pop(FILE), settings.pop(HASH)))
    hashes += [(key.removeprefix(HASH_OF), settings.pop(key)) for key in list(settings) if key.startswith(HASH_OF)]
    blocks: list[PageBlock] = [_LEAD]
    if text:
        blocks.append(Fold(f"Configuration: {origin}" if origin else "Configuration", (Code(text),)))
    if hashes:
        blocks.append(pairs("file", hashes, "SHA-256 of the files that were read"))
    blocks.append(pairs("package", list(identification.versions.items()), "Versions"))
    blocks.append(Fold("All settings", (pairs("setting", list(settings.items())),)))
    return PageSection("To repeat the run", tuple(blocks))
