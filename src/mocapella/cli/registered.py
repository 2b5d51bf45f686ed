"""Groups of commands that packages can extend: ``mocapella node``, ``mocapella export`` and ``mocapella stream``.

A command's module is imported when it runs or prints its help; a list of commands shows names and summaries only.
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from mocapella.errors import SettingsError


class RegisteredVerbs(TyperGroup):
    """The commands of a `mocapella.registry.Table` whose descriptors have a ``summary`` and a ``command``."""

    verb_class: type[TyperCommand] = TyperCommand

    def table(self) -> Any:
        """The table, imported on first use."""
        raise NotImplementedError

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands: built-in ones, then those of the table."""
        return [*super().list_commands(ctx), *self.table()]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a placeholder with a command's summary, for lists; `resolve_command` returns the command itself."""
        descriptor = self.table().get(cmd_name)
        if descriptor is None:
            return super().get_command(ctx, cmd_name)
        return TyperCommand(cmd_name, help=descriptor.summary, rich_markup_mode=self.rich_markup_mode)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name and the command of a command line, imported from the table if it is registered there.

        An unknown name ends the program with a usage error.

        Raises:
            PluginError: the command is registered but cannot be used.
        """
        if args[0] in self.commands or args[0].startswith("-"):
            return super().resolve_command(ctx, args)
        try:
            return args[0], self.verb(args[0]), args[1:]
        except SettingsError as error:
            return ctx.fail(str(error))

    def verb(self, name: str) -> Any:
        """Import a command.

        Raises:
            SettingsError: there is no command of that name.
            PluginError: it cannot be used.
        """
        from mocapella.registry import load

        one = typer.Typer(add_completion=False, rich_markup_mode=self.rich_markup_mode, pretty_exceptions_enable=False)
        descriptor = self.table().find(name)
        function = load(descriptor.command)
        one.command(name, cls=self.verb_class, help=self.help_of(descriptor, inspect.getdoc(function) or ""))(function)
        return typer.main.get_command(one)

    def help_of(self, descriptor: Any, doc: str) -> str:
        """Return a command's help, given the docstring of its function."""
        return doc


class NodeVerbs(RegisteredVerbs):
    """The commands of ``mocapella node``."""

    def table(self) -> Any:
        """The table of sources."""
        from mocapella.sources.source import SOURCES

        return SOURCES


class _ExportVerb(TyperCommand):
    def invoke(self, ctx: Any) -> Any:
        from mocapella.cli import DAMAGED
        from mocapella.cli.recordings import open_take, tell_left_out

        if "take" not in ctx.params:  # an export of several takes does this for each
            return super().invoke(ctx)
        take = Path(ctx.params["take"])  # typer converts it later
        tell_left_out(str(self.name), take)
        result = super().invoke(ctx)
        if open_take(take).damaged:
            raise typer.Exit(DAMAGED)
        return result


class ExportVerbs(RegisteredVerbs):
    """The commands of ``mocapella export``.

    Each first prints which parts of the take it leaves out, and ends with exit status 3 if the take is damaged.
    """

    verb_class = _ExportVerb

    def help_of(self, descriptor: Any, doc: str) -> str:
        """Return the export's summary before the docstring that several exports share."""
        return (
            f"{descriptor.summary}\n\n{doc.replace('export trc', f'export {descriptor.name}')}"
            if descriptor.write
            else doc
        )

    def table(self) -> Any:
        """The table of exports."""
        from mocapella.exports.export import EXPORTS

        return EXPORTS


class StreamVerbs(RegisteredVerbs):
    """The commands of ``mocapella stream``."""

    def help_of(self, descriptor: Any, doc: str) -> str:
        """Return the stream's summary before the docstring that the streams share."""
        shared = doc.replace(
            "stream osc --to 127.0.0.1:9000", f"stream {descriptor.name} --to 127.0.0.1:{descriptor.port}"
        )
        return f"{descriptor.summary}\n\n{shared}"

    def table(self) -> Any:
        """The table of streams."""
        from mocapella.streams.stream import STREAMS

        return STREAMS
