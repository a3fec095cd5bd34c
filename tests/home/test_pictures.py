"""Pictures of a home: what they show and what they refuse."""

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home import pictures
from perdure.home.pictures import Studio, goal_marks, overview, render_scene
from perdure.home.tasks.episodes import load_episodes


@pytest.fixture(scope="module")
def episode():
    return load_episodes("set_table", "val")[3]


@pytest.fixture(scope="module")
def simulator(episode):
    return render_scene(episode, 0)


@pytest.fixture
def picture(simulator, monkeypatch):
    monkeypatch.setattr(pictures.Studio, "shadows", 256)  # the large ones take most of the time

    def take(camera, size, marks=(), path=()):
        try:
            with Studio(simulator, size) as studio:
                return studio.take(camera, marks, path)
        except PerdureError as error:
            pytest.skip(f"this machine has neither EGL nor OSMesa: {error}")

    return take


def test_a_picture_has_its_size_and_shows_something(picture):
    shown = picture("doll_house", (160, 120))
    assert shown.shape == (120, 160, 3)
    assert shown.dtype == np.uint8
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 100


def test_marks_are_seen(picture, episode):
    plain, marked = picture("doll_house", (320, 240)), picture("doll_house", (320, 240), goal_marks(episode))
    changed = (plain != marked).any(axis=2).mean()
    assert 0.001 < changed < 0.2


def test_a_picture_shows_the_state(picture, simulator, episode):
    """An apple that floats in the middle of the room is red where the floor was not."""
    plain = picture("plan", (320, 240)).astype(int)
    position = simulator.object(1)[0]
    before, room = position.copy(), np.array(episode.apartment().room)
    try:
        position[:3] = (*room.mean(axis=0), 2.0)
        simulator.forward()
        moved = picture("plan", (320, 240)).astype(int)
    finally:
        position[:] = before
        simulator.forward()
    middle = (slice(90, 150), slice(130, 190))
    redder = (moved[middle] - plain[middle]) @ (2, -1, -1)
    assert redder.max() > 100


@pytest.mark.parametrize("camera", ["plan", "follow", "head", "hand"])
def test_every_camera_takes_pictures(picture, camera):
    assert picture(camera, (96, 64)).std() > 5.0


@pytest.mark.parametrize(("camera", "size", "message"), [("roof", (64, 64), "roof"), ("plan", (8, 64), "16 to")])
def test_unknown_cameras_and_sizes_are_refused(picture, camera, size, message):
    with pytest.raises(PerdureError, match=message):
        picture(camera, size)


@pytest.mark.parametrize("camera", ["plan", "doll_house"])
@pytest.mark.parametrize("size", [(900, 600), (300, 600)])
def test_the_overview_fits_into_the_picture(episode, camera, size):
    """Corners at floor height, projected by hand, are inside the picture and reach to its edges."""
    apartment = episode.apartment()
    shot = overview(apartment, camera, size)
    corners = np.array([(x, y, z) for x, y in apartment.room for z in (0.0, pictures.LOW_WALL)])
    right, up, depth = shot.axes @ (corners - shot.eye).T
    tangent = np.tan(np.radians(0.5 * pictures.FOVY))
    across = np.abs(right / depth) / (tangent * size[0] / size[1])
    upward = np.abs(up / depth) / tangent
    assert max(across.max(), upward.max()) == pytest.approx(0.95, abs=0.01)


def test_a_line_is_seen_where_it_is(picture, episode):
    """Both ends, projected by hand from straight above, are the ends of what has changed."""
    middle = np.append(np.array(episode.apartment().room).mean(axis=0), 2.0)
    ends = [middle + np.array([x, 0.2, 0.0]) for x in (-0.5, 0.8)]
    shot = pictures.Shot(middle + np.array([0.0, 0.0, 3.0]), middle, (0.0, 1.0, 0.0))
    plain = picture(shot, (320, 240)).astype(int)
    drawn = picture(shot, (320, 240), (), [(end, (0, 0, 255)) for end in ends]).astype(int)
    rows, columns = np.nonzero((drawn - plain) @ (-1, -1, 2) > 100)
    scale = 120.0 / np.tan(np.radians(0.5 * pictures.FOVY)) / 3.0
    np.testing.assert_allclose([columns.min(), columns.max()], [160.0 - 0.5 * scale, 160.0 + 0.8 * scale], atol=2.0)
    np.testing.assert_allclose(rows, 120.0 - 0.2 * scale, atol=2.0)


def test_a_pixel_is_the_mean_of_four(picture, monkeypatch):
    small = picture("doll_house", (80, 60)).astype(float)
    monkeypatch.setattr("perdure.film.SUPERSAMPLING", 1)
    large = picture("doll_house", (160, 120)).astype(float)
    np.testing.assert_allclose(small, large.reshape(60, 2, 80, 2, 3).mean(axis=(1, 3)), atol=0.51)


def test_a_camera_outside_sees_through_the_wall_that_is_cut_away_alone():
    """This room is an L: beyond the wall at x = 6.4 m lies, for y > 2.6 m, the back of another wall."""
    simulator = render_scene(load_episodes("prepare_groceries", "eval")[26], 0)
    follower, point = pictures.Follower(simulator), np.array([6.2, 2.0, 2.0])
    assert follower.sees(point, np.array([7.0, 2.2, 2.2]), -1) == 1.0
    assert follower.sees(point, np.array([7.0, 3.0, 2.2]), -1) == 0.0
