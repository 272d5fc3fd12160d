"""``dynident export``: write a saved result for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from dynident.cli.options import ALLOW_CODE, FILE, RESULT
from dynident.cli.terminal import console, say_line, tell

__all__ = ["export"]


class _Format(click.ParamType):  # type: ignore[type-arg,unused-ignore]  # generic in newer versions
    """A kind of exporter, looked up only when it is needed."""

    name = "format"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        from dynident.io.families import EXPORTERS

        return f"[{'|'.join(EXPORTERS.kinds())}]"

    def get_missing_message(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        from dynident.io.families import EXPORTERS

        return f"One of {', '.join(EXPORTERS.kinds())}."

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from dynident.errors import choices
        from dynident.io.families import EXPORTERS

        if value not in EXPORTERS.table and value not in (kinds := EXPORTERS.kinds()):
            self.fail(f"{value!r} is not a format; {choices(value, kinds)}", param, ctx)
        return value


@click.command(short_help="Write a saved result as a robot file, YAML, or Python module.")
@click.argument("result", type=RESULT)
@click.option("--format", "kind", type=_Format(), required=True, help="Format.")
@click.option("--out", type=FILE, required=True, help="File to write.")
@ALLOW_CODE
def export(result: Path, kind: str, out: Path, allow_code: bool) -> None:
    """Write the model in RESULT (the result.json of identify), after a check of its torque at random states."""
    from dataclasses import replace

    import numpy as np

    from dynident.errors import ModelError
    from dynident.export import Identified, random_states
    from dynident.export import export as make
    from dynident.io.families import EXPORTERS
    from dynident.io.model_files import moved_to
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import probe_folder, write_text
    from dynident.io.saved import load
    from dynident.report.exports import export_notes
    from dynident.report.wording import old_result_lines
    from dynident.report.words import tiny

    keep(result)
    refuse_inputs(out)
    probe_folder(out.parent)
    found, exporter = load(result, allow_code=allow_code), EXPORTERS.get(kind)()
    refuse_inputs(out)
    estimate, states = found.estimate, random_states(len(found.model.joints), np.random.default_rng(0))
    identified = Identified(found.model, estimate.value, estimate.std, tuple(estimate.provenance))
    (made,) = moved_to(out.parent, [make(identified, exporter, states)], found.provenance)
    if not made.ready or made.written is None or made.proof is None:
        raise ModelError(f"{out}: not written: {made.refusal}")
    screen = console()
    for line in old_result_lines(found):
        say_line(screen, line)
    for note in (
        *export_notes([replace(made, file=out.name)], "listed here"),
        *(f"Not in the file: {words}" for words in made.written.left_out),
        *(f"{words}." for words in made.proof.skipped),
    ):
        screen.say(note)
    screen.say(
        f"Loaded again, its torque differs from each joint's by a share of {tiny(made.proof.agreement)} at most."
    )
    tell(screen, "Model", write_text(out, made.written.text))
