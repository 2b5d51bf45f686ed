"""`python -m benchmarks [GROUP…] [--part NAME] [--json FILE] [--quick] [--against REVISION] …`: print tables."""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import json
import sys
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import Row, machine
from benchmarks.revision import in_turns
from mocapella.errors import one_of


def groups() -> list[str]:
    """The names of the modules beside this one that have a function ``run``; none is imported for it."""
    return sorted(path.stem for path in Path(__file__).parent.glob("*.py") if _defines_run(path))


def main(arguments: list[str] | None = None) -> int:
    """Run the requested groups; exit status 0 also if a goal is missed, unless ``--strict``."""
    there_are = groups()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure Mocapella beside its peers, in one run.",
        epilog="example: python -m benchmarks codec --json rows.json",
    )
    parser.add_argument("group", nargs="*", help="which to run; all where none is named: " + ", ".join(there_are))
    parser.add_argument("--json", metavar="FILE", help="write the rows as JSON; - writes them to standard output")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions, to see that it runs")
    parser.add_argument(
        "--part", action="append", default=[], metavar="NAME", help="only this one, of a group of parts"
    )
    parser.add_argument("--inputs", type=_count, metavar="N", help="inputs of fuzz, frames of soak, kills of kill")
    parser.add_argument("--processes", type=_count, metavar="N", help="of fuzz; one for each core if not given")
    parser.add_argument(
        "--slice", type=_slice, dest="slice_of", metavar="K/N", help="of fuzz: only the K-th of N slices of its inputs"
    )
    parser.add_argument("--against", metavar="REVISION", help="measure in turns with an earlier revision (git)")
    parser.add_argument("--strict", action="store_true", help="exit with 1 where a goal is missed")
    options = parser.parse_args(arguments)
    for name in options.group:
        if name not in there_are:
            parser.error(f"no group {name!r}; there are {one_of(name, there_are)}")
    chosen = options.group or there_are
    parts = {name: _parts(name) for name in chosen} if options.part else {}
    for part in options.part:
        known = [each for names in parts.values() for each in names]
        if part not in known:
            parser.error(f"no part {part!r} in {', '.join(chosen)}; there are {one_of(part, known) or 'none'}")
    console = Console(stderr=options.json == "-")
    rows: list[Row] = []
    if options.against:
        with console.status(f"measuring in turns with {options.against} …"):
            rows = in_turns(options.against, chosen, _repeated(options))
        console.print(table(f"against {options.against}", rows))
        chosen = []
    for name in chosen:
        wanted = [part for part in options.part if part in parts[name]]
        if options.part and not wanted:
            continue
        with console.status(f"measuring {name} …"):
            run = importlib.import_module(f"benchmarks.{name}").run
            asked = {"parts": wanted} if wanted else {}
            for option in ("inputs", "processes", "slice_of"):
                if (value := getattr(options, option)) is not None and option in inspect.signature(run).parameters:
                    asked[option] = value
            measured = run(quick=options.quick, **asked)
        console.print(table(name, measured))
        rows += measured
    if options.json:
        _write([asdict(row) for row in rows], options.json)
    return 1 if options.strict and any(row.met is False for row in rows) else 0


def table(group: str, rows: list[Row]) -> Table:
    """The rows of a group, for a person."""
    result = Table(title=group, caption=machine(), title_justify="left", caption_justify="left")
    for heading in ("what", "value", "peer", "ratio", "goal", "met"):
        result.add_column(heading, justify="right" if heading in ("value", "ratio") else "left")
    for row in rows:
        met = {None: "", True: "[green]yes[/]", False: "[red]no[/]"}[row.met]
        ratio = "" if row.ratio is None else f"{row.ratio:.3g} ×"
        peer = "none" if row.ratio is None else row.peer
        result.add_row(row.name, f"{row.value:.4g} {row.unit}", peer, ratio, row.goal or "", met)
    return result


def _repeated(options: argparse.Namespace) -> list[str]:
    """Return the arguments that an earlier revision is measured with, too."""
    words = ["--quick"] * options.quick + [word for part in options.part for word in ("--part", part)]
    for name in ("inputs", "processes"):
        if (value := getattr(options, name)) is not None:
            words += [f"--{name}", str(value)]
    return words


def _count(text: str) -> int:
    """A number such as 1000 or 1e8."""
    value = float(text)
    if not (value.is_integer() and 1 <= value <= 1e12):
        raise ValueError(text)
    return int(value)


def _slice(text: str) -> tuple[int, int]:
    """The numbers of a slice such as 2/5."""
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r} is no slice such as 2/5, the second of five")
    return int(number), int(count)


def _parts(group: str) -> list[str]:
    """What a group can be asked for alone; most are one."""
    return list(getattr(importlib.import_module(f"benchmarks.{group}"), "PARTS", ()))


def _defines_run(path: Path) -> bool:
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return any(isinstance(node, ast.FunctionDef) and node.name == "run" for node in body)


def _write(rows: list[dict[str, object]], target: str) -> None:
    text = json.dumps(rows, indent=2, ensure_ascii=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    partial = Path(target + ".part")
    partial.write_text(text, encoding="utf-8")
    partial.replace(target)


if __name__ == "__main__":
    sys.exit(main())
