"""Every setting of a configuration, with extreme values: each ends in a result or in one sentence, soon.

The sections and their fields are found by introspection (``extremes.py``), so that a new setting is tried without a
line here. The suite tries a sample of all; ``DYNIDENT_TRIALS=5000 pytest tests/laws/test_settings.py`` tries more, and
another ``DYNIDENT_SEED`` others.
"""

import os
import random
import re
import time
import warnings

import pytest
from pydantic import BaseModel

from dynident.project import drive_settings as loops
from dynident.project import fields as channels
from dynident.project import settings
from dynident.project.fields import Section
from tests.cli.commands import run
from tests.laws.extremes import as_yaml, base, changed, sections, trials, write_inputs

TRIALS, SEED = int(os.environ.get("DYNIDENT_TRIALS", "120")), int(os.environ.get("DYNIDENT_SEED", "0"))
LONGEST = 10.0  # s of processor time


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("settings")
    write_inputs(made)
    return made


def tried(folder, config, command):
    """Run a command on a configuration; return its exit code, output, warnings of Python, and seconds."""
    path = folder / "c.yaml"
    path.write_text(as_yaml(config))
    began = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        done = run(command, path)
    return done.exit_code, done.output, [str(x.message) for x in caught], time.process_time() - began


def test_every_section_is_tried(folder):
    """The sections are all those that settings.py defines or uses, and the configurations to start from work."""
    every = [value for module in (settings, channels, loops) for value in vars(module).values()]
    own = {x for x in every if isinstance(x, type) and issubclass(x, BaseModel)}
    abstract = {BaseModel, Section, loops.LoopSettings, loops.LoopJoint}
    assert own - abstract <= {kind for kind, _, _ in sections().values()}
    done = []
    for where, (_, _, config) in sections().items():
        if config not in done:  # several sections are of one configuration
            code, output, caught, _ = tried(folder, config, "identify")
            assert (code, caught) == (0, []), (where, output)
            done.append(config)


def test_extreme_settings_end_in_a_sentence(folder):
    every, reference, wrong = trials(), sections(), []
    chosen = random.Random(SEED).sample(every, min(TRIALS, len(every)))
    for where, name, value in chosen:
        config = changed(reference[where][2], reference[where][1], name, value)
        for command in ("check", "identify"):
            code, output, caught, seconds = tried(folder, config, command)
            quiet = not caught and "Traceback" not in output
            if code not in (0, 1) or not quiet or seconds > LONGEST or not output.strip():
                wrong.append((where, name, short(value), command, code, caught[:1], seconds, output[-300:]))
    assert wrong == []


def short(value):
    return "a huge number" if isinstance(value, int) and abs(value) > 10**300 else repr(value)[:60]


HUGE = int("f" * 4000, 16)
CAUSES = {
    "huge": ("", "min_speed", HUGE, ("line 26", "0xffff", "number of 4002 digits")),
    "gain of 0": ("torque", "gain", 0, ("torque.slider.gain: a gain other than 0", "got 0")),
    "huge gain": ("position", "gain", 1e300, ("position.slider.gain: a finite number, at most 1e+15", "got 1e+300")),
    "gravity": ("model", "gravity", [0, 0, 1e300], ("model.gravity[2]: a number from -1000 to 1000 m/s^2",)),
    "decimate": ("filter", "decimate", 10**9, ("filter.decimate: a whole number from 1 to 1000000",)),
    "slow decimate": ("filter", "decimate", 20_000, ("for decimate = 20000, 0.002 Hz is too low for 3 s", "0.033 Hz")),
    "cut-off": ("filter", "cutoff", 1e-9, ("cut-off 1e-09 Hz is too low for 3 s", "at least 0.033 Hz")),
    "order": ("filter", "order", 500, ("filter.order: a whole number from 1 to 12",)),
    "spacing": ("maximum_likelihood", "spacing", 1e-9, ("estimator.spacing: should be greater than or equal to 0.25",)),
    "rounds": ("maximum_likelihood", "rounds", 10**18, ("estimator.rounds: should be less than or equal to 20",)),
    "time offset": (
        "",
        "time_offset",
        1e9,
        ("time_offset: a number from -60 to 60 s", "got 1000000000.0", "'estimate'"),
    ),
    "long time offset": ("", "time_offset", 50, ("time_offset", "50 s", "no sample of its 3 s is left")),
    "tolerance": ("least_squares", "tolerance", 0.5, ("estimator.tolerance: should be less than or equal to 0.01",)),
    "butterworth": ("butterworth", "cutoffs", [1e-9] * 3, ("cut-off of 1e-09 Hz is too low", "at least 0.033 Hz")),
    "mass": ("consistent robot", "total_mass", [-1e300, -1e300], ("total mass: the limits -1e+300", "1e+09 at most")),
    "many terms": ("model", "terms", [1] * 1000, ("model.terms: at most 100 entries",)),
    "too many S": ("spline", "S", [1, 1], ("S has 2 entries, but the data have 1 column",)),
    "narrow": ("model", "coulomb_width", 5e-324, ("model.coulomb_width: a number from 1e-15",)),
    "true": ("filter", "order", True, ("filter.order: a whole number from 1 to 12 is expected; got True",)),
    "nan": ("", "zero", {"slider": float("nan")}, ("zero.slider: a finite number is expected; got nan",)),
}


@pytest.mark.parametrize(("where", "name", "value", "words"), CAUSES.values(), ids=CAUSES)
def test_the_value_its_place_and_its_limits_are_named_by_both_commands(folder, where, name, value, words):
    _, place, config = sections()[where]
    code, output, caught, seconds = tried(folder, changed(config, place, name, value), "identify")
    assert (code, caught) == (1, [])
    assert seconds < LONGEST
    assert output.startswith("Error: ")
    for word in words:
        assert word in output, output
    code, output, caught, _ = tried(folder, changed(config, place, name, value), "check")
    assert (code, caught) == (1, [])
    assert "1 error" in output
    assert re.sub(r"\W", "", words[-1]) in re.sub(r"\W", "", output), output


def test_deep_settings_are_refused(folder):
    for depth in (100, 100_000):
        for deep in ("[" * depth + "]" * depth, "{a: " * depth + "1" + "}" * depth, "&a [*a]"):
            (folder / "c.yaml").write_text(as_yaml(base()) + f"filter: {deep}\n")
            done = run("identify", folder / "c.yaml")
            assert done.exit_code == 1
            said = "more than 50000 values" if deep.startswith("&") else "nested too deep"
            assert said in done.output
