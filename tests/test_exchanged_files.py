"""Folders of files that belong together: all are new, or all are the old ones."""

import pytest

from regrasp_opt.files import exchanged_files


def content(folder):
    return {path.name: path.read_text("utf-8") for path in folder.iterdir() if path.is_file()}


def write(folder, *names):
    with exchanged_files(folder, "index") as fresh:
        for name in names:
            (fresh / name).write_text(f"new {name}", encoding="utf-8")


def test_files_are_exchanged_and_others_stay(tmp_path):
    for name in ("a", "index", "notes"):
        (tmp_path / name).write_text("old", encoding="utf-8")
    write(tmp_path, "index", "a", "z")
    assert content(tmp_path) == {"a": "new a", "index": "new index", "notes": "old", "z": "new z"}
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_after_a_failure_nothing_has_changed(tmp_path, error):
    (tmp_path / "a").write_text("old", encoding="utf-8")
    for folder in (tmp_path, tmp_path / "new"):
        with pytest.raises(error), exchanged_files(folder, "index") as fresh:
            (fresh / "a").write_text("half", encoding="utf-8")
            raise error
    assert [path.name for path in tmp_path.iterdir()] == ["a"] and content(tmp_path) == {"a": "old"}


def test_an_error_names_the_file_that_was_to_be_written(tmp_path):
    with pytest.raises(OSError) as caught, exchanged_files(tmp_path, "index") as fresh:
        (fresh / "none" / "a").write_text("")
    assert caught.value.filename == str(tmp_path / "none" / "a")


def test_no_file_refers_to_others_that_are_half_exchanged(tmp_path):
    (tmp_path / "index").write_text("old", encoding="utf-8")
    (tmp_path / "b").mkdir()  # which no file can replace
    with pytest.raises(OSError):
        write(tmp_path, "a", "b", "index")
    assert content(tmp_path) == {"a": "new a"}
