"""Settings that the silhouettes' commands pass on to the method."""

from __future__ import annotations

import pytest

from mocapella.cli.command_settings import read_keys
from mocapella.cli.demo import DemoKeys
from mocapella.cli.silhouette_keys import REJECTIONS, fit_settings
from mocapella.cli.silhouettes import SilhouetteKeys
from mocapella.errors import SettingsError
from mocapella.settings import parse
from mocapella.tracker import silhouette_settings
from mocapella.tracker.silhouette_settings import SilhouetteSettings


def test_ways_to_reject_images_are_those_of_the_method() -> None:
    assert REJECTIONS == silhouette_settings.REJECTIONS
    assert SilhouetteSettings().rejection == REJECTIONS[0]


@pytest.mark.parametrize("kind", [SilhouetteKeys, DemoKeys])
@pytest.mark.parametrize("steady", [True, False])
@pytest.mark.parametrize("rejection", REJECTIONS)
def test_settings_reach_the_method(kind: type, steady: bool, rejection: str) -> None:
    keys = read_keys(kind, None, [f"steadiness={str(steady).lower()}", f"rejection={rejection}"])
    fit = parse(SilhouetteSettings, fit_settings(keys))
    assert (fit.steadiness is not None) == steady
    assert fit.rejection == rejection
    assert fit_settings(kind()) == {}


@pytest.mark.parametrize("kind", [SilhouetteKeys, DemoKeys])
def test_an_unknown_way_is_refused(kind: type) -> None:
    with pytest.raises(SettingsError, match=r"rejection is 'nome'; it must be one of adaptive, none"):
        read_keys(kind, None, ["rejection=nome"])
