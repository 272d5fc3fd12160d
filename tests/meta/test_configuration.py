"""The page of the configuration has every key with its default, and configurations that are shown are valid."""

import re
from typing import Any

import pytest
import yaml
from pydantic import TypeAdapter

from dynident.apps.excitation import JointLimits
from dynident.apps.excitation.config import BoxSettings, CylinderSettings, ExcitationSettings
from dynident.apps.fleets.config import FleetSettings, RobotChanges
from dynident.apps.ranking.config import CompareSettings
from dynident.project import drive_settings, fields, settings
from dynident.project.config import parse_config
from dynident.project.fields import UNITS, Section
from dynident.project.parts import build_part, section
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS
from tests.meta.test_docs import PAGES, ROOT, blocks, title

EXAMPLES = sorted((ROOT / "examples").glob("*.yaml"))
FAMILIES = {"smoother": SMOOTHERS, "estimator": ESTIMATORS}
PARTS = {
    f"{word} {kind.replace('_', ' ')}": section(family, family.get(kind))
    for word, family in FAMILIES.items()
    for kind in family.table
}
PARTS["estimator"] = PARTS.pop("estimator least squares")
APPLICATIONS: dict[str, type[Section]] = {
    "excitation": ExcitationSettings,
    "compare": CompareSettings,
    "joint limits": JointLimits,
    "box": BoxSettings,
    "cylinder": CylinderSettings,
    "fleet": FleetSettings,
    "robot of a fleet": RobotChanges,
}
SECTIONS: dict[str, type[Section]] = {
    "top level": settings.Config,
    "time": settings.Time,
    "position": fields.PositionChannel,
    "torque": fields.Channel,
    "logs": settings.LogSpec,
    "robot": settings.RobotSettings,
    "coupling": settings.CouplingSettings,
    "filter": settings.FilterSettings,
    "simulation from torque": drive_settings.TorqueInputSettings,
    "simulation of servos": drive_settings.ServoSettings,
    "servo of a joint": drive_settings.ServoJoint,
}
# by kind, the settings of a controller and of its drives: one table for all, with a column of kinds
LOOPS: dict[str, tuple[type[Section], type[Section]]] = {
    "cascade": (drive_settings.CascadeSettings, drive_settings.CascadeJoint),
    "pd": (drive_settings.PDSettings, drive_settings.PDJoint),
    "pid": (drive_settings.PIDSettings, drive_settings.PIDJoint),
    "function": (drive_settings.FunctionSettings, drive_settings.FunctionJoint),
}
MAPPINGS = {PARTS["estimator consistent"]: ("bounds", "centre_of_mass")}  # kept as pairs


def text_below(heading: str) -> str:
    """The text of configuration.md below a heading."""
    text = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    (part,) = re.findall(rf"^## (?i:{heading})\n((?:(?!## ).*\n)*)", text, flags=re.MULTILINE)
    return str(part)


def rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading of configuration.md, without its head."""
    table = [line for line in text_below(heading).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:]]


def default(section: type[Section], key: str) -> Any:
    """The default of a setting, as YAML would give it."""
    field = section.model_fields[key]
    value = "required" if field.is_required() else field.get_default(call_default_factory=True)
    if section is settings.Config and key in FAMILIES:
        rule = {"rule": value.rule} if key == "smoother" else {}
        return {"kind": FAMILIES[key].kind_of(build_part(value)[0] if rule else build_part(value))} | rule
    if section in MAPPINGS and key in MAPPINGS[section]:
        value = dict(value)
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.parametrize(("heading", "section"), (SECTIONS | PARTS | APPLICATIONS).items())
def test_configuration_keys_and_defaults(heading: str, section: type[Section]) -> None:
    told = {key.strip("`"): yaml.safe_load(shown.strip("`")) for key, shown, *_ in rows(heading)}
    # the kind of a part is said above its table
    assert told == {key: default(section, key) for key in section.model_fields if key != "kind"}
    if "kind" in section.model_fields:
        part = heading.partition(" ")[2].replace(" ", "_") or "least_squares"
        assert f"`kind: {part if heading in PARTS else ''}" in text_below(heading)


@pytest.mark.parametrize("kind", LOOPS)
def test_configuration_keys_and_defaults_of_loops(kind: str) -> None:
    for heading, settings_of_loop in zip(("simulation in a loop", "drive"), LOOPS[kind], strict=True):
        told = {
            key.strip("`"): yaml.safe_load(shown.strip("`"))
            for key, shown, kinds, *_ in (row for row in rows(heading) if len(row) == 4)
            if kinds == "all" or kind in kinds.split(", ")
        }
        assert told == {key: default(settings_of_loop, key) for key in settings_of_loop.model_fields}


def test_configuration_lists_every_term_with_its_settings() -> None:
    told = {}
    for kind, given, *_ in rows("Terms"):
        pairs = re.findall(r"`(\w+)` (required|`[^`]*`)", given)
        told[kind.strip("`")] = {key: yaml.safe_load(shown.strip("`")) for key, shown in pairs}
    common = {"kind", "on", "names", "expressions", "values"}
    parts = {kind: section(TERMS, TERMS.get(kind)) for kind in TERMS.table}
    own = {kind: [key for key in part.model_fields if key not in common] for kind, part in parts.items()}
    assert told == {kind: {key: default(parts[kind], key) for key in keys} for kind, keys in own.items()}


def test_configuration_has_every_section_and_unit() -> None:
    sections = {
        value
        for module in (settings, fields, drive_settings)
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Section)
    }
    bases = {Section, fields.Angle, drive_settings.LoopSettings, drive_settings.LoopJoint}
    assert {*SECTIONS.values(), *(section for pair in LOOPS.values() for section in pair)} == sections - bases
    for dimension, units in rows("Units"):
        assert re.findall(r"`([^`]+)`", units) == list(UNITS[dimension])
    assert len(rows("Units")) == len(UNITS)


def configurations() -> list[Any]:
    return [
        pytest.param(block["body"], id=title(page))
        for page in PAGES
        for block in blocks(page)
        if block["kind"] == "yaml"
    ] + [pytest.param(path.read_text(encoding="utf-8"), id=title(path)) for path in EXAMPLES]


@pytest.mark.parametrize("text", configurations())
def test_configurations_shown_are_valid(text: str) -> None:
    if "recipe" in (given := yaml.safe_load(text)):
        FleetSettings.model_validate(given)
    elif "compare" in given and "model" not in given:
        CompareSettings.model_validate(given["compare"])
    elif given.keys() == {"simulation"}:
        TypeAdapter(settings.Simulation).validate_python(given["simulation"])
    elif "model" not in given:
        ExcitationSettings.model_validate(given)
    else:
        assert parse_config(text).train
