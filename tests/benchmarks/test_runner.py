import csv
import json
import logging
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from regrasp_opt.benchmarks.harness.runner import Item, dask_cluster, run_items, write_csv
from regrasp_opt.errors import MeshError, OptionError
from regrasp_opt.files import atomic_path


def work(folder, number):
    """Leave a mark for each call, so that a test can count them."""
    with open(folder / f"calls-{number}", "a", encoding="utf-8") as file:
        file.write("x")
    if number == 3:
        raise MeshError("this one is broken")
    return [{"value": 10 * number}, {"value": 10 * number + 1}]


def calls(folder, number):
    path = folder / f"calls-{number}"
    return len(path.read_text(encoding="utf-8")) if path.exists() else 0


def items(folder, depends="a"):
    return [Item(f"item {n}", depends, work, (folder, n), {"number": n}) for n in range(5)]


def run(folder, depends="a", jobs=1):
    return run_items(items(folder, depends), folder / "items", jobs=jobs, quiet=True)


def test_rows_come_in_the_order_of_the_items_with_their_columns(tmp_path):
    rows = run(tmp_path, jobs=2).rows
    assert [row["number"] for row in rows] == [0, 0, 1, 1, 2, 2, 3, 4, 4]
    assert [row.get("value") for row in rows] == [0, 1, 10, 11, 20, 21, None, 40, 41]


def test_an_item_that_fails_becomes_a_row_and_is_tried_again(tmp_path):
    rows = run(tmp_path).rows
    assert [row["error"] for row in rows if "error" in row] == ["this one is broken"]
    run(tmp_path)
    assert [calls(tmp_path, n) for n in range(5)] == [1, 1, 1, 2, 1]


def test_a_killed_run_goes_on_without_repeating_or_losing_rows(tmp_path):
    every = items(tmp_path)
    run_items(every[:2], tmp_path / "items", jobs=1, quiet=True)
    rows = run(tmp_path).rows
    assert len(rows) == 9 and [calls(tmp_path, n) for n in range(5)] == [1, 1, 1, 1, 1]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"key": "item 1"}', '{"key": "x", "revision": "", "rows": []}'])
def test_a_corrupt_file_is_reported_and_made_again(tmp_path, caplog, content):
    before = run(tmp_path).rows
    (tmp_path / "items" / items(tmp_path)[1].file_name).write_text(content, encoding="utf-8")
    with caplog.at_level(logging.WARNING):
        assert run(tmp_path).rows == before
    assert items(tmp_path)[1].file_name in caplog.text and "corrupt" in caplog.text
    assert calls(tmp_path, 1) == 2


def test_rows_of_other_settings_are_not_taken(tmp_path):
    run(tmp_path)
    run(tmp_path, depends="b")
    assert calls(tmp_path, 0) == 2


def test_the_revision_of_the_code_is_kept_with_the_rows(tmp_path):
    run(tmp_path)
    path = tmp_path / "items" / items(tmp_path)[0].file_name
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**content, "revision": "older"}), encoding="utf-8")
    assert "older" in run(tmp_path).revisions and len(run(tmp_path).revisions) == 2


def test_two_items_of_one_key_are_refused(tmp_path):
    twice = [items(tmp_path)[0]] * 2
    with pytest.raises(OptionError, match="same key"):
        run_items(twice, tmp_path, jobs=1, quiet=True)


def test_csv_holds_all_columns(tmp_path):
    write_csv([{"a": 1}, {"b": None, "a": "x,y"}], tmp_path / "rows.csv")
    with open(tmp_path / "rows.csv", newline="", encoding="utf-8") as file:
        assert list(csv.DictReader(file)) == [{"a": "1", "b": ""}, {"a": "x,y", "b": ""}]


def test_a_dask_scheduler_that_does_not_exist_is_one_sentence():
    with pytest.raises(OptionError, match="Dask"), dask_cluster("tcp://127.0.0.1:1"):
        pass


@pytest.fixture(scope="module")
def cluster():
    """Return a scheduler and two worker processes on loopback."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as running:
        yield running


def process():
    """Return one row that says which process made it."""
    return [{"process": os.getpid()}]


def test_a_dask_cluster_does_the_work(cluster, tmp_path):
    todo = [Item(f"process {i}", "", process, (), {}) for i in range(8)]
    with dask_cluster(cluster.scheduler_address):
        rows = run_items(todo, tmp_path, quiet=True).rows
    assert len(rows) == 8 and os.getpid() not in {row["process"] for row in rows}


def square(folder, number):
    """Return one row, and count the tries; the first try at number 0 waits to be killed."""
    tries = Path(folder) / f"tries-{number}"
    first = not tries.exists()
    with open(tries, "a", encoding="utf-8") as file:
        file.write("x")
    if number == 0 and first:
        with atomic_path(Path(folder) / "victim") as path:
            path.write_text(str(os.getpid()), encoding="utf-8")
        time.sleep(60)
    return [{"square": number**2}]


def test_a_killed_worker_loses_and_doubles_nothing(cluster, tmp_path):
    todo = [Item(f"square {i}", "a", square, (str(tmp_path), i), {"number": i}) for i in range(12)]

    def kill_the_victim():
        while not (tmp_path / "victim").exists():
            time.sleep(0.05)
        os.kill(int((tmp_path / "victim").read_text(encoding="utf-8")), signal.SIGKILL)

    killer = threading.Thread(target=kill_the_victim)
    killer.start()
    with dask_cluster(cluster.scheduler_address):
        rows = run_items(todo, tmp_path / "items", quiet=True).rows
    killer.join()
    assert rows == [{"number": i, "square": i**2} for i in range(12)]
    assert (tmp_path / "tries-0").read_text(encoding="utf-8") == "xx"  # what was lost ran again
    assert run_items(todo, tmp_path / "items", jobs=1, quiet=True).rows == rows


def test_without_an_address_nothing_changes():
    with dask_cluster(None):
        pass
