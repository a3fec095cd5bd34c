"""write_atomic: the old file or the new one, never half of it."""

import os
import resource
import signal
import stat
import subprocess
import sys
import textwrap

import pytest

from perdure.errors import PerdureError
from perdure.runs import file_digest, read_bounded, write_atomic


def names(folder):
    return sorted(entry.name for entry in os.scandir(folder))


def run_script(script, *arguments):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)], capture_output=True, text=True
    )


def test_bytes_and_text_arrive_unchanged_and_alone(tmp_path):
    assert write_atomic(tmp_path / "a.bin", b"\x00\r\n\xff") == tmp_path / "a.bin"
    write_atomic(tmp_path / "b.txt", "gr\u00fc\u00df\r\ndich\n")
    assert (tmp_path / "a.bin").read_bytes() == b"\x00\r\n\xff"
    assert (tmp_path / "b.txt").read_bytes() == b"gr\xc3\xbc\xc3\x9f\r\ndich\n"
    assert names(tmp_path) == ["a.bin", "b.txt"]


def test_a_name_that_is_no_utf_8_is_written(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff.onnx")
    write_atomic(path, b"data")
    assert path.read_bytes() == b"data"
    assert os.listdir(os.fsencode(tmp_path)) == [b"\xff.onnx"]


def test_missing_folders_are_made_and_an_old_file_is_replaced(tmp_path):
    path = tmp_path / "x" / "y" / "file"
    write_atomic(path, "old, and longer than the new one")
    write_atomic(path, "new")
    assert path.read_text() == "new"


def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    write_atomic(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_the_file_gets_the_permissions_an_ordinary_open_would_give(tmp_path):
    write_atomic(tmp_path / "ours", "x")
    (tmp_path / "plain").write_text("x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_an_old_file_keeps_its_permissions(tmp_path):
    (tmp_path / "secret").write_text("old")
    (tmp_path / "secret").chmod(0o600)
    write_atomic(tmp_path / "secret", "new")
    assert (tmp_path / "secret").read_text() == "new"
    assert stat.S_IMODE((tmp_path / "secret").stat().st_mode) == 0o600


def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match=r"is not a regular file.*pipe"):
        write_atomic(tmp_path / "pipe", "x")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert names(tmp_path) == ["pipe"]


def test_a_name_of_the_greatest_length_can_be_written(tmp_path):
    write_atomic(tmp_path / ("n" * 255), "x")
    assert names(tmp_path) == ["n" * 255]


def test_a_full_disk_leaves_the_old_file_whole_and_names_it(tmp_path):
    # A limit on file size fails the write in its middle, exactly where a full disk would.
    script = """
        import resource, signal, sys
        from perdure.runs import write_atomic
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            write_atomic(sys.argv[1], b"n" * 10_000)
        except OSError as error:
            print(error)
            sys.exit(7)
    """
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 4096
    write_atomic(tmp_path / "file", b"old" * 2000)
    result = run_script(script, tmp_path / "file")
    assert result.returncode == 7, result.stderr
    assert str(tmp_path / "file") in result.stdout
    assert (tmp_path / "file").read_bytes() == b"old" * 2000
    assert names(tmp_path) == ["file"]


def test_what_a_killed_writer_left_is_removed_by_the_next_one_and_a_living_writer_is_not_disturbed(tmp_path):
    # The writer stops right before its rename; SIGSTOP keeps it alive, SIGKILL then makes its file a leftover.
    script = """
        import os, signal, sys
        from perdure.runs import write_atomic
        os.replace = lambda *_: os.kill(os.getpid(), signal.SIGSTOP)
        write_atomic(sys.argv[1], "never arrives")
    """
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "file")])
    os.waitpid(process.pid, os.WUNTRACED)
    assert len(names(tmp_path)) == 1
    write_atomic(tmp_path / "file", "first")
    assert len(names(tmp_path)) == 2, "the temporary file of a living writer must stay"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert (tmp_path / "file").read_text() == "first"
    write_atomic(tmp_path / "file", "second")
    assert names(tmp_path) == ["file"]
    assert (tmp_path / "file").read_text() == "second"


def test_a_folder_in_the_way_is_an_error_that_names_it(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        write_atomic(tmp_path / "taken", "x")
    assert names(tmp_path) == ["taken"]


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_what_is_no_regular_file_is_not_read(tmp_path, make):
    """A FIFO would block for ever, /dev/zero would fill the memory."""
    path = tmp_path / "model.zip"
    make(path)
    for read in (lambda: read_bounded(path, 10), lambda: file_digest(path)):
        with pytest.raises(PerdureError, match=r"model\.zip"):
            read()


def test_files_are_read_up_to_a_size(tmp_path):
    path = write_atomic(tmp_path / "file", b"12345")
    assert read_bounded(path, 5) == b"12345"
    with pytest.raises(PerdureError, match=r"5 bytes.*4"):
        read_bounded(path, 4)
