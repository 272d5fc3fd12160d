"""``dynident schema``: the JSON schemas of the configuration and of results."""

from __future__ import annotations

import os
from pathlib import Path

import click

from dynident.cli.options import FILE
from dynident.cli.terminal import console, tell
from dynident.cli.voice import complain

__all__ = ["schema"]


@click.command(short_help="Print a JSON schema, by which editors complete a configuration.")
@click.argument("kind", type=click.Choice(["config", "result", "fleet"]), default="config")
@click.option("--out", type=FILE, help="File to write it to.")
def schema(kind: str, out: Path | None) -> None:
    """Print the JSON schema (draft 2020-12) of the configuration (config), of result.json (result), or of the
    configuration of a fleet (fleet).

    That of the configuration has the settings of all kinds of parts, those of installed packages too.
    """
    import json

    from dynident.errors import InputError
    from dynident.fleets.settings import fleet_schema
    from dynident.io.families import ESTIMATORS, SMOOTHERS, TERMS
    from dynident.io.opener import content
    from dynident.io.parts import unusable
    from dynident.io.results import write_json
    from dynident.io.schema import SCHEMAS

    found = {**SCHEMAS, "fleet": fleet_schema}[kind]()
    for family in (SMOOTHERS, TERMS, ESTIMATORS) if kind == "config" else ():
        for words in unusable(family):
            complain(f"Warning: its settings are not in the schema: {words}")
    if out and os.path.exists(out) and b'"$schema"' not in content(out, remember=False):
        raise InputError(f"{out}: exists already and is no schema; choose another name.")
    if out:
        tell(console(), "Schema", write_json(out, found))
    else:
        click.echo(json.dumps(found, indent=2, ensure_ascii=False))
