"""``mocapella study run``: lead participants through the tasks of a study."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from mocapella.cli.app import study_app
from mocapella.cli.command_settings import SettingsFile, set_option
from mocapella.cli.common import DEFAULT_PORT, BusPort, Host, JsonOut, Method, SensorsExpected, View, method_keys
from mocapella.cli.serve import ServeKeys, run_server
from mocapella.cli.study_protocol import Operator, StudyDir

if TYPE_CHECKING:
    from mocapella.live.study_service import StudyStore


@study_app.command()
def run(
    folder: StudyDir,
    by: Operator,
    port: BusPort = DEFAULT_PORT,
    host: Host = "127.0.0.1",
    sensors: SensorsExpected = 1,
    method: Method = "default",
    view: View = True,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(ServeKeys, method_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Lead participants through a study's tasks, live; sensors connect as to `mocapella serve`.

    It prints the address of the researcher's page and of the participant's screen, and goes on with a session that
    was interrupted. docs/studies-session.md describes its takes.

    Example:  mocapella study run my-study --by OP1 --sensors 2
    """

    def store() -> StudyStore:
        from mocapella.live.study_store import FolderStore

        return FolderStore(folder, by)

    run_server(
        port=port, host=host, sensors=sensors, method=method, view=view, settings_file=settings_file,
        settings=settings, json=json, store=store,
    )  # fmt: skip
