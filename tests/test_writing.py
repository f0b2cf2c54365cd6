"""Files appear complete or not at all."""

import errno
import os
from itertools import count
from pathlib import Path

import pytest

import servocore as sc
from servocore.files import require_places, write_together


def test_text_and_bytes_are_written_whole(tmp_path: Path) -> None:
    write_together({tmp_path / "text": "grün\n", tmp_path / "bytes": b"\x00\xff"})
    assert (tmp_path / "text").read_text(encoding="utf-8") == "grün\n"
    assert (tmp_path / "bytes").read_bytes() == b"\x00\xff"
    assert (tmp_path / "text").stat().st_mode & 0o777 == 0o644


def test_several_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(sc.InvalidSetting, match="nowhere"):
        write_together({tmp_path / "one": "1", tmp_path / "nowhere" / "two": "2"})
    assert os.listdir(tmp_path) == []


def test_an_interrupted_write_leaves_no_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_together({tmp_path / "new.txt": "content"})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("failure", [OSError, KeyboardInterrupt])
def test_whichever_rename_fails_all_files_are_as_they_were(
    failure: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = {"first": "old", "third": "old", "last": "old"}
    write_together({tmp_path / name: text for name, text in old.items()})
    rename, left = Path.replace, 0

    def failing_once(source: Path, place: Path) -> Path:
        nonlocal left
        left -= 1
        if left == 0:
            raise failure(errno.EACCES, os.strerror(errno.EACCES))
        return rename(source, place)

    monkeypatch.setattr(Path, "replace", failing_once)
    new = dict.fromkeys(("first", "second", "third", "last"), "new")
    for left in count(1):
        failed = left
        try:
            write_together({tmp_path / name: text for name, text in new.items()})
            break
        except (sc.InvalidSetting, KeyboardInterrupt):
            assert {each.name: each.read_text() for each in tmp_path.iterdir()} == old
    assert failed > len(new)
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == new


def test_a_folder_where_a_file_shall_be_leaves_the_others_as_they_were(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    write_together({tmp_path / "old": "old"})
    with pytest.raises(sc.InvalidSetting, match=r"cannot write .*folder: Is a directory"):
        write_together({tmp_path / name: "new" for name in ("old", "folder", "another")})
    assert (tmp_path / "old").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["folder", "old"]


def test_a_symbolic_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_together({tmp_path / "link": "new"})
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "new"


def test_a_place_that_can_be_written_is_accepted(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("old")
    require_places({"--output": tmp_path / "old", "--plot": tmp_path / "new", "--csv": None}, [tmp_path / "read", None])


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("folder", "cannot write folder: it is a folder"),
        ("read", "cannot write read: it is read as well"),
        ("./folder/../read", "it is read as well"),
        ("nowhere/new", "cannot write nowhere/new: there is no folder nowhere"),
        ("pipe", "cannot write pipe: it is no ordinary file"),
        ("-", "cannot write -: name a file; without a file, tables go to the standard output stream"),
        ("other", "--plot and --output both name other"),
    ],
)
@pytest.mark.usefixtures("empty_folder")
def test_a_place_that_cannot_be_written_is_refused_before_the_work(name: str, sentence: str) -> None:
    Path("folder").mkdir()
    Path("read").touch()
    os.mkfifo("pipe")
    with pytest.raises(sc.InvalidSetting, match=sentence.replace(".", r"\.")):
        require_places({"--plot": Path("other"), "--output": Path(name)}, [Path("read")])
