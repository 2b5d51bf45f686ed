"""``mocapella demo``: track in a simulated room, with the same processes and messages as with real sensors."""

from __future__ import annotations

import dataclasses
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli.app import LIVE, app
from mocapella.cli.arm import DEFAULT_DETECTOR, Detector, not_method
from mocapella.cli.command_settings import KeySpec, read_keys, set_option
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_VIEW_PORT,
    SESSION_SECONDS,
    BusPort,
    JsonOut,
    Method,
    NoBrowser,
    RecordTo,
    SceneName,
    Seed,
    View,
    ViewPort,
    check_scene,
    chosen,
    exit_by,
    record_file,
    say,
    seconds_option,
    working,
    write_json,
)
from mocapella.cli.silhouette_keys import REJECTION, fit_settings
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.model.session import Setup


class What(StrEnum):
    """Types of tracking that the demo can show."""

    PEOPLE = "people"
    HANDS = "hands"
    ARM = "arm"
    SILHOUETTES = "silhouettes"
    WEBCAM = "webcam"


@dataclass(frozen=True)
class DemoKeys:
    """Settings of the command `demo`, for ``--set``."""

    steadiness: Annotated[bool, KeySpec("Of silhouettes: penalise jitter; false fits every frame independently.")] = (
        True
    )
    rejection: Annotated[
        str, dataclasses.replace(REJECTION, meaning="Of silhouettes: leave out wrong images; none uses all.")
    ] = "adaptive"
    corrupt: Annotated[str | None, KeySpec("Of silhouettes: corrupt the images.", "noise|rectangles|wrong")] = None


@app.command(rich_help_panel=LIVE)
def demo(
    context: typer.Context,
    what: Annotated[
        What,
        typer.Argument(metavar="[WHAT]", help="people, hands with painted fingertips, an arm, silhouettes, or webcam."),
    ] = What.PEOPLE,
    scene: SceneName = None,
    method: Method = "default",
    detector: Detector = DEFAULT_DETECTOR,
    seconds: Annotated[float | None, seconds_option(SESSION_SECONDS)] = None,
    view: View = True,
    no_browser: NoBrowser = False,
    record: RecordTo = None,
    port: BusPort = DEFAULT_PORT,
    view_port: ViewPort = DEFAULT_VIEW_PORT,
    seed: Seed = 0,
    settings: Annotated[list[str] | None, set_option(DemoKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Simulate a room with three sensors, two people and an obstacle, track the people live, and open the view.

    `demo hands` renders a hand with painted fingertips before two cameras, detects the paint in their images, and fits
    a hand model. `demo arm` renders an arm before a depth camera, detects it and its fingers in the images, and lets it
    grab a cloth; --scene is one of the arm's scenes there (cloth), and --detector the detector. `demo silhouettes`
    renders a running person before four cameras (or another --scene), and fits a body model to the silhouettes.
    `demo webcam` has two people before four webcams, whose keypoints a simulated detector finds (or another --scene).

    Needs no hardware and downloads nothing. Every sensor is a process of its own, as real ones are.

    Example:  mocapella demo --scene walk --seconds 30 --record walk-1
    """
    from mocapella.cli.live_session import finish, live_session, say_url, start_together, wait_while
    from mocapella.live.launch import check_port_free
    from mocapella.live.server import ServerSettings
    from mocapella.live.signals import stop_on_signals
    from mocapella.wire.address import Address
    from mocapella.wire.session_key import session_name

    named_detector, named_method = chosen(context, "detector", detector), chosen(context, "method", method)
    wanted_port, wanted_view_port = chosen(context, "port", port), chosen(context, "view_port", view_port)
    if what is not What.ARM and named_detector is not None:
        raise SettingsError("--detector is of demo arm; leave it out")
    keys = read_keys(DemoKeys, None, settings)
    if what is What.SILHOUETTES:
        from mocapella.cli.silhouettes_demo import run_demo

        _refuse_bus_options({"--record": record, "--port": wanted_port, "--method": named_method})
        run_demo(
            scene, seed, keys.corrupt, seconds=seconds, fit=fit_settings(keys), view=view, view_port=wanted_view_port,
            no_browser=no_browser, json=json,
        )  # fmt: skip
        return
    if keys != DemoKeys():
        raise SettingsError("steadiness, rejection and corrupt are settings of demo silhouettes; leave them out")
    if what is What.ARM and named_method is not None:
        raise SettingsError(not_method(named_method))
    if what in (What.HANDS, What.WEBCAM) and named_method is not None:
        raise SettingsError(f"--method {named_method}: demo {what} has one method; leave it out")
    take = None if record is None else record_file(record)
    show_of = _SHOWS[what](Wish(scene, method, named_detector, seed))
    bus_port = choose_port(wanted_port, DEFAULT_PORT)
    if wanted_port is not None:
        check_port_free("127.0.0.1", wanted_port, "--port")
    page_port = choose_port(wanted_view_port, DEFAULT_VIEW_PORT) if view else None
    listen = str(Address(session_name(), "127.0.0.1", bus_port))
    served = ServerSettings(listen=listen, setup=show_of.setup, method_settings=show_of.method_settings)

    def show(url: str) -> None:
        say_url(url)
        if not no_browser:
            webbrowser.open(url)

    at_once = take is not None or seconds is not None  # neither a take nor the seconds begin without results
    with stop_on_signals() as stop:
        with live_session(
            served, stop, view_port=page_port, on_url=show, tell_watch_url=False, view_words=show_of.view,
            track_at_once=at_once,
        ) as session:  # fmt: skip
            if take is not None:
                say(session.server.record_to(take))
            start_together(session, [[*words, "--connect", listen] for words in show_of.nodes])
            say(f"{show_of.words} (Ctrl-C ends)")
            wait_while(session, seconds)
            summary = finish(session.server)
        write_json(json, summary)
    exit_by(summary["recording"])


def _refuse_bus_options(given: Mapping[str, object]) -> None:
    for option, value in given.items():
        if value is not None:
            raise SettingsError(f"{option}: demo silhouettes has no bus and one method; leave it out")


@dataclass(frozen=True)
class Show:
    """Setup of a demo.

    Attributes:
        setup: the session's configuration.
        method_settings: settings of the tracking method.
        nodes: arguments of ``mocapella node`` for each sensor.
        words: description of the demo, which is printed.
        view: further options of ``mocapella view``.
    """

    setup: Setup
    method_settings: dict[str, Any]
    nodes: list[list[str]]
    words: str
    view: tuple[str, ...] = ()


@dataclass(frozen=True)
class Wish:
    """Options of a demo as given on the command line: scene, tracking method, detector and random seed.

    Attributes:
        scene: name of the simulated scene; None for the demo's default.
        method: name of the tracking method.
        detector: name of the detector of arms; None for the default.
        seed: seed of the simulated noise.
    """

    scene: str | None
    method: str
    detector: str | None
    seed: int


def _people_show(wish: Wish) -> Show:
    from mocapella.model.session import Setup
    from mocapella.sources.simulate import scene_settings

    scene, seed = check_scene(wish.scene or "obstacle"), wish.seed
    names = [sensor.name for sensor in scene_settings(scene).sensors]
    words = ["--scene", scene, "--seed", str(seed)]
    nodes = [["simulate", "--sensor", name, *words] for name in names]
    said = f"simulating {scene}: sensors {', '.join(names)}"
    return Show(Setup(method=wish.method, sensors_expected=len(names)), {}, nodes, said, ("--scenery", scene))


def _hands_show(wish: Wish) -> Show:
    from mocapella.model.camera_rig_file import encode_camera_rig
    from mocapella.model.hand_file import encode_hand_shape
    from mocapella.model.session import Setup
    from mocapella.sources.simulate.hand_camera import SimulatedHandCamera
    from mocapella.sources.simulate.hand_scene import base_places, load_hand_scene

    made = load_hand_scene("demo", seed=wish.seed)
    names = list(made.cameras)
    with working("making the hand …", status=0):
        next(SimulatedHandCamera(made, names[0]).frames())  # compiles once a machine, and not in every camera at once
    settings = {
        "rig": encode_camera_rig(made.rig),
        "hand": encode_hand_shape(made.shape).decode(),
        "base_places_m": base_places(made).tolist(),
        "rays": {"acceleration_density": 8.0},  # a quiet hand, and few frames a second
    }
    nodes = [["markers", f"rendered:demo/{name}", "--seed", str(wish.seed), "--set", "report=0"] for name in names]
    said = f"rendering a hand: cameras {', '.join(names)}"
    return Show(Setup(method="hands", sensors_expected=len(names)), settings, nodes, said)


def _arm_show(wish: Wish) -> Show:
    import numpy as np

    from mocapella.cli.common import need_cameras, telling_of_compiling
    from mocapella.detectors import make_detector
    from mocapella.model.camera import Camera
    from mocapella.model.session import Setup
    from mocapella.sources.simulate.depth_scene import depth_scene_names, load_depth_scene

    scene, detector, seed = wish.scene or "cloth", wish.detector or DEFAULT_DETECTOR, wish.seed
    if scene == "help":
        typer.echo("\n".join(depth_scene_names()))
        raise typer.Exit
    need_cameras("demo arm")
    with working("making the arm …", status=0), telling_of_compiling(f"the rendered arm and the detector {detector}"):
        made = load_depth_scene(scene, seed=seed)
        shot = made.at(0.0)  # compiles once a machine, and not while the camera is running
        finds = make_detector(detector, Camera("arm", made.sensor.size_px, made.lens))
        for k in range(3):
            finds.update(made.at(k / 30).depth * np.float32(shot.unit_m), k / 30)
    words = [
        "arm",
        f"rendered:{scene}/{seed}",
        "--detector",
        detector,
        "--set",
        "drop_after_ms=1000",
        "--set",
        "report=0",
    ]
    said = f"rendering an arm before a depth camera: {scene}"
    return Show(Setup(method="arms", sensors_expected=1), {}, [words], said, ("--cloth",))


def _webcam_show(wish: Wish) -> Show:
    from mocapella.model.camera_rig_file import encode_camera_rig
    from mocapella.model.session import Setup
    from mocapella.sources.simulate.crowd import crowd_summaries
    from mocapella.sources.simulate.keypoint_source import DEFAULT_CROWD, SIMULATED, rig_of, shown_crowd

    name = wish.scene or DEFAULT_CROWD
    if name == "help":
        typer.echo("\n".join(f"{scene}: {summary}" for scene, summary in crowd_summaries().items()))
        raise typer.Exit
    with working("making the room …", status=0):
        scene = shown_crowd(name, wish.seed)
    names = list(scene.rig.cameras)
    settings = {"rig": encode_camera_rig(rig_of(scene))}
    nodes = [["keypoints", f"{SIMULATED}{name}/{camera}", "--seed", str(wish.seed)] for camera in names]
    said = f"simulating {scene.settings.summary}: cameras {', '.join(names)}"
    return Show(Setup(method="webcams", sensors_expected=len(names)), settings, nodes, said)


_SHOWS: Final[Mapping[What, Callable[[Wish], Show]]] = {
    What.PEOPLE: _people_show,
    What.HANDS: _hands_show,
    What.ARM: _arm_show,
    What.WEBCAM: _webcam_show,
}


def choose_port(wanted: int | None, default: int) -> int:
    """Return the TCP port to use: the requested one, else the default, or any free port if the default is in use.

    The requested port is not checked.
    """
    from mocapella.errors import BusError
    from mocapella.live.launch import check_port_free, free_port

    if wanted is not None:
        return wanted
    try:
        check_port_free("127.0.0.1", default, "")
    except BusError:
        return free_port()
    return default
