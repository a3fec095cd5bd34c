"""Films and pictures as files: complete or refused, and what ffmpeg says is heard. Captions fit."""

from itertools import combinations

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from perdure import film
from perdure.errors import PerdureError
from perdure.film import INK, annotate, check_film, save_picture, strip_height, tile, write_film, write_labels

SIZE = (64, 48)


def pictures(count, size=SIZE):
    width, height = size
    for k in range(count):
        yield np.full((height, width, 3), (10 * k) % 256, np.uint8)


def test_a_film_has_its_pictures_and_its_rate(tmp_path):
    assert write_film(pictures(10), tmp_path / "film.mp4", 20.0) == 10
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    facts = next(reader)
    assert (facts["size"], facts["fps"]) == (SIZE, 20.0)
    shown = [np.frombuffer(each, np.uint8).mean() for each in reader]
    np.testing.assert_allclose(shown, [10 * k for k in range(10)], atol=3)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_an_animation_has_its_pictures_and_its_rate(tmp_path, suffix):
    shades = [np.full((48, 64, 3), 70 + 100 * (k % 2), np.uint8) for k in range(10)]  # WebP merges what is alike
    assert write_film(shades, tmp_path / f"film{suffix}", 12.5) == 10
    with Image.open(tmp_path / f"film{suffix}") as animation:
        assert (animation.size, animation.n_frames) == (SIZE, 10)
        animation.seek(6)
        assert np.asarray(animation.convert("L")).mean() == pytest.approx(70, abs=3)
        assert animation.info["duration"] == 80
    write_film(shades, tmp_path / f"fast{suffix}", 30.0)
    with Image.open(tmp_path / f"fast{suffix}") as animation:
        lasts = [animation.seek(k) or (animation.load() and animation.info["duration"]) for k in range(10)]
    assert sum(lasts) == pytest.approx(10_000 / 30.0, abs=10)


def test_labels_do_not_cover_each_other():
    """Three at one point, and one at the edge: no two share a row and a column, and all are whole."""
    paper = np.full((100, 200, 3), 255, np.uint8)
    colors = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 0, 255)]
    at = [(100.0, 90.0), (100.0, 90.0), (101.0, 88.0), (198.0, 60.0)]
    written = write_labels(paper, [(*point, "apple", color) for point, color in zip(at, colors, strict=True)])
    boxes = []
    for color in colors:
        rows, columns = np.nonzero((written == color).all(axis=2))
        boxes.append((rows.min(), rows.max(), columns.min(), columns.max()))
    heights, widths = {b - a for a, b, _, _ in boxes}, {b - a for _, _, a, b in boxes}
    assert max(heights) - min(heights) <= 1
    assert max(widths) - min(widths) <= 1
    for (a, b, c, d), (e, f, g, h) in combinations(boxes, 2):
        assert b < e or f < a or d < g or h < c


def test_points_outside_a_picture_get_no_label():
    paper = np.full((100, 200, 3), 255, np.uint8)
    outside = [(250.0, 50.0), (100.0, -5.0), (np.nan, np.nan), (100.0, 3.0)]  # the last one: no room above it
    assert (write_labels(paper, [(*point, "apple", INK) for point in outside]) == 255).all()


def test_a_full_disk_is_an_error(tmp_path):
    """/dev/full takes no byte; a cut film must not count as written."""
    noise = np.random.default_rng(0).integers(0, 256, (60, 48, 64, 3), np.uint8)
    link = tmp_path / "film.mp4"
    link.symlink_to("/dev/full")

    def write():
        with film._mp4(link, 25) as add:
            for picture in noise:
                add(picture)

    with pytest.raises(PerdureError, match=r"ffmpeg could not write the film: .*No space left"):
        write()


@pytest.mark.parametrize("suffix", film.SUFFIXES)
def test_a_film_that_breaks_off_leaves_no_file(tmp_path, suffix):
    def broken():
        yield from pictures(1)
        raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        write_film(broken(), tmp_path / f"film{suffix}", 25.0)
    with pytest.raises(PerdureError, match="at least one picture"):
        write_film([], tmp_path / f"film{suffix}", 25.0)
    assert list(tmp_path.iterdir()) == []


def test_pictures_that_make_no_film_are_refused_with_the_reason(tmp_path):
    with pytest.raises(PerdureError, match="not divisible by 2"):
        write_film(pictures(3, (63, 48)), tmp_path / "film.mp4", 25.0)
    assert list(tmp_path.iterdir()) == []


def test_a_colon_in_a_name_is_no_protocol(tmp_path):
    write_film(pictures(3), tmp_path / "film-12:30.mp4", 25.0)
    assert [path.name for path in tmp_path.iterdir()] == ["film-12:30.mp4"]


def test_names_of_other_files_are_refused(tmp_path):
    with pytest.raises(PerdureError, match=r"a picture is written as \.png, not as x\.jpg"):
        save_picture(next(pictures(1)), tmp_path / "x.jpg")
    with pytest.raises(PerdureError, match=r"a film is written as \.mp4, \.gif, \.webp, not as x\.avi"):
        write_film(pictures(1), tmp_path / "x.avi", 25.0)


def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(film, "find_spec", lambda module: None if module == "imageio_ffmpeg" else True)
    with pytest.raises(PerdureError, match=r"need imageio-ffmpeg: pip install 'perdure\[film\]'"):
        check_film(tmp_path / "film.mp4")


def test_long_captions_are_written_smaller():
    words = "always 100,000 steps to go: fails silently from step 99,999"
    rows = [(20, [(words, INK)])]
    written = annotate(np.zeros((64, 320, 3), np.uint8), rows, rows)
    top = strip_height(rows)
    assert written.shape == (64 + 2 * top, 320, 3)
    assert (written[:top, -7:] == 255).all(), "nothing is cut at the edge"
    assert (written[:top, 250:310] != 255).any(), "and the room is used"
    assert (written[top : top + 64] == 0).all(), "the picture is left as it is"


def test_a_sheet_puts_pictures_side_by_side():
    sheet = tile([np.full((10, 20, 3), value, dtype=np.uint8) for value in (1, 2, 3)], columns=2, gap=4)
    assert sheet.shape == (24, 44, 3)
    assert (sheet[0, 0, 0], sheet[0, 24, 0], sheet[14, 0, 0], sheet[14, 24, 0]) == (1, 2, 3, 255)
