"""A film is complete or refused: what ffmpeg says is heard."""

import imageio_ffmpeg
import numpy as np
import pytest

from perdure.render import Mp4Writer, RenderError

SIZE = (64, 48)


def pictures(count, size=SIZE):
    width, height = size
    for k in range(count):
        yield np.full((height, width, 3), (10 * k) % 256, np.uint8)


def write(path, shown, rate=25.0):
    writer = Mp4Writer(path, rate)
    try:
        for picture in shown:
            writer.add(picture)
        writer.close()
    finally:
        writer.abort()
    return writer


def test_a_film_has_its_pictures_and_its_rate(tmp_path):
    write(tmp_path / "film.mp4", pictures(10), rate=20.0)
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    facts = next(reader)
    assert (facts["size"], facts["fps"]) == (SIZE, 20.0)
    shown = [np.frombuffer(each, np.uint8).mean() for each in reader]
    np.testing.assert_allclose(shown, [10 * k for k in range(10)], atol=3)


def test_the_same_pictures_give_the_same_bytes(tmp_path):
    for name in ("one", "other"):
        write(tmp_path / f"{name}.mp4", pictures(10))
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "other.mp4").read_bytes()


def test_a_full_disk_is_an_error(tmp_path):
    """/dev/full takes no byte; before, ffmpeg's exit code was not looked at and a cut film counted as written."""
    noise = np.random.default_rng(0).integers(0, 256, (60, 48, 64, 3), np.uint8)
    link = tmp_path / "film.mp4"
    link.symlink_to("/dev/full")
    with pytest.raises(RenderError, match=r"ffmpeg could not write the film film\.mp4: .*No space left"):
        write(link, noise)


def test_an_ffmpeg_that_dies_is_an_error(tmp_path):
    writer = Mp4Writer(tmp_path / "film.mp4", 25.0)
    writer.add(next(pictures(1)))
    writer._process.kill()
    writer._process.wait()
    with pytest.raises(RenderError, match="it gave no reason"):
        writer.close()
    writer.abort()


def test_pictures_of_another_size_and_none_at_all_are_refused(tmp_path):
    with pytest.raises(RenderError, match="at least one picture"):
        write(tmp_path / "none.mp4", [])
    with pytest.raises(RenderError, match="96 x 48 pixels, the first one 64 x 48"):
        write(tmp_path / "two.mp4", [*pictures(1), *pictures(1, (96, 48))])


def test_a_colon_in_a_name_is_no_protocol(tmp_path):
    write(tmp_path / "film-12:30.mp4", pictures(3))
    assert [path.name for path in tmp_path.iterdir()] == ["film-12:30.mp4"]
