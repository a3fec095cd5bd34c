"""Pictures and films: what they show, what they refuse, and files that are written whole."""

import numpy as np
import pytest

from perdure.home.benchmark.episodes import episode_scene, load_episodes, start_pose
from perdure.home.errors import HomeError
from perdure.home.sim.world import SceneOptions, VectorSimulator
from perdure.home.video import FilmOptions, film_episode, goal_marks, render_lane, save_picture
from perdure.home.video.files import open_film
from perdure.home.video.film import tile
from perdure.render import RenderError


@pytest.fixture(scope="module")
def episode():
    return load_episodes("set_table", "val")[3]


@pytest.fixture(scope="module")
def lane(episode):
    world = VectorSimulator(1)
    scene = episode_scene(episode, SceneOptions(visuals=True))
    world.reset(0, scene, start_pose(scene.apartment, episode, 0))
    return world.simulator(0)


def picture(lane, *arguments, **options):
    try:
        return render_lane(lane, *arguments, **options)
    except RenderError as error:
        if "no picture can be drawn" in str(error):
            pytest.skip("this machine has neither EGL nor OSMesa")
        raise


def test_a_picture_has_its_size_and_shows_something(lane):
    shown = picture(lane, "doll_house", (160, 120))
    assert shown.shape == (120, 160, 3)
    assert shown.dtype == np.uint8
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 100


def test_marks_are_seen(lane, episode):
    assert (
        picture(lane, "doll_house", (320, 240)) != picture(lane, "doll_house", (320, 240), goal_marks(episode))
    ).any()


@pytest.mark.parametrize("camera", ["plan", "follow", "head", "hand"])
def test_every_camera_takes_pictures(lane, camera):
    assert picture(lane, camera, (96, 64)).std() > 5.0


@pytest.mark.parametrize(("camera", "size", "message"), [("roof", (64, 64), "roof"), ("plan", (8, 64), "16 to")])
def test_wrong_wishes_are_refused(lane, camera, size, message):
    with pytest.raises(HomeError, match=message):
        picture(lane, camera, size)


@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_is_written_whole(episode, tmp_path, name):
    try:
        log = film_episode(episode, tmp_path / name, FilmOptions(size=(96, 64), speed=8.0, seconds=1.0))
    except RenderError as error:
        if "no picture can be drawn" in str(error):
            pytest.skip("this machine has neither EGL nor OSMesa")
        raise
    assert log is None  # it ended before the episode
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes()[:8].startswith((b"GIF8", b"\x00\x00\x00"))


def test_a_film_that_fails_leaves_nothing_behind(tmp_path):
    def break_down():
        with open_film(tmp_path / "film.gif") as film:
            film.add(np.zeros((64, 64, 3), dtype=np.uint8))
            raise RuntimeError("the camera fell over")

    with pytest.raises(RuntimeError, match="camera"):
        break_down()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"), [({"speed": 0.0}, "speed"), ({"seconds": 0.0}, "longer than"), ({"size": (95, 64)}, "even")]
)
def test_wrong_films_are_refused(options, message):
    with pytest.raises(HomeError, match=message):
        FilmOptions(**options)


def test_names_that_are_no_pictures_are_refused(tmp_path):
    with pytest.raises(HomeError, match="written as"):
        save_picture(np.zeros((16, 16, 3), dtype=np.uint8), tmp_path / "x.jpg")
    with pytest.raises(HomeError, match="written as"), open_film(tmp_path / "x.avi"):
        pass


def test_a_sheet_puts_pictures_side_by_side():
    sheet = tile([np.full((10, 20, 3), value, dtype=np.uint8) for value in (1, 2, 3)], columns=2, gap=4)
    assert sheet.shape == (24, 44, 3)
    assert (sheet[0, 0, 0], sheet[0, 24, 0], sheet[14, 0, 0], sheet[14, 24, 0]) == (1, 2, 3, 255)
