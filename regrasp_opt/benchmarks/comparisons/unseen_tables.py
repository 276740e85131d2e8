"""What `bench any` tells of its rows."""

from __future__ import annotations

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.report import Table
from regrasp_opt.benchmarks.harness.runner import Row

TEXT = (
    "Plans for meshes and obstacles that nothing was prepared for, with the energy of the arm, which was trained "
    "without any object. A pair of poses can be planned if a search over exactly checked random resting poses solves "
    "it; their number is `truth` in the settings, and the N of the pair the least that they allow. Only such pairs are "
    "planned for; they share no grasp, unless a mesh has too few such pairs. A plan is given up after `time_limit` "
    "seconds. Times are by the clock, one thread, one plan after the other; the load of the machine is not controlled."
)


def any_tables(rows: list[Row]) -> list[Table]:
    """Return the tables of the rows of `run_any`."""
    return [_first(rows), _success(rows), _parts(rows), _meshes(rows), _missed(rows), _refused(rows)]


def _first(rows: list[Row]) -> Table:
    timed = {
        label: [{**row, "seconds": row[key]} for row in rows if key in row]
        for key, label in (("first", "mesh file to plan, warm process"), ("moved", "obstacles put in to plan"))
    }
    done = [{**row, "seconds": row["seconds"] if row["exit"] == 0 else None} for row in rows if "exit" in row]
    timed["mesh file to plan, whole process"] = done
    warm = [row for row in rows if row.get("part") == "built-in" and "planner" in row and row["num_regrasps"] == 1]
    for planner in ("arm energy", "own energy"):
        timed[f"built-in object, one regrasp, {planner}"] = [row for row in warm if row["planner"] == planner]
    columns = {
        "measured": len,
        "planned": tables.count(lambda row: row["seconds"] is not None),
        "median [s]": tables.middle("seconds"),
        "p95 [s]": tables.late("seconds"),
        "longest [s]": tables.largest("seconds"),
        "median, processor [s]": tables.middle("processor", of=lambda row: row["seconds"] is not None),
    }
    return tables.summary(
        "Time to a verified plan",
        ("what",),
        timed,
        columns,
        "Warm process: reading the file, grasps, lattice and plan. Whole process: `regrasp-opt plan --object FILE` "
        "with an empty data folder, for the same pair. Obstacles: `with_obstacles` and the plan, on a problem "
        "that has planned without them. Built-in objects: lattice and solvers are there.",
    )


def _success(rows: list[Row]) -> Table:
    columns: dict[str, tables.Column] = {
        "pairs": len,
        "solved [%]": tables.share("solved"),
        "N no larger [%]": tables.share(lambda row: row["num_regrasps"] <= row["minimum"], of="solved"),
        "N smaller": tables.count(lambda row: row["solved"] and row["num_regrasps"] < row["minimum"]),
        "unrefined [%]": tables.share("unrefined", of="solved"),
        "median [s]": tables.middle("seconds", of="solved"),
        "p95 [s]": tables.late("seconds", of="solved"),
    }
    return tables.summary(
        "Success by planner",
        ("where", "planner"),
        tables.grouped(rows, "part", "planner"),
        columns,
        "Own energy: that of the object, trained for it. Exact: no energy, random poses and exact checks. Constant "
        "energy: the control, the same exact rules and planner with an energy that knows nothing. Random poses: 1,000 "
        "of them, ranked by the energy. Unrefined: plans from lattice chains as they are. Times are of plans in a warm "
        "process.",
    )


def _parts(rows: list[Row]) -> Table:
    first = [row for row in rows if row.get("first") is not None]
    names = {
        "read": "reading and placements",
        "sampling": "grasps",
        "t_ends": "exact check of both ends",
        "t_starts": "lattice and chains",
        "t_refine": "Ipopt, the solver made",
        "t_verify": "verification",
    }
    groups = {meaning: [{"seconds": row.get(key, 0.0)} for row in first] for key, meaning in names.items()}
    columns = {"median [s]": tables.middle("seconds"), "p95 [s]": tables.late("seconds")}
    return tables.summary("Where the time of a first plan goes", ("part",), groups, columns)


def _meshes(rows: list[Row]) -> Table:
    pairs = [row for row in rows if row.get("planner") == "arm energy" and row["part"] == "meshes"]
    by_name = tables.by_object(pairs, [row["object"] for row in pairs])

    def share(row: Row) -> str:
        here = by_name[row["object"]]
        return f"{sum(pair['solved'] for pair in here)} of {len(here)}"

    def seconds(key: str) -> tables.Value:
        return lambda row: None if row[key] is None else round(row[key], 2)

    columns: dict[str, tables.Value] = {
        "mesh": "object",
        **{name: name for name in ("faces", "placements", "grasps")},
        "grasps [s]": seconds("sampling"),
        "first plan [s]": seconds("plan"),
        "in all [s]": seconds("first"),
        "pairs with a plan [%]": lambda row: None if row["share"] is None else round(100 * row["share"], 1),
        "solved": share,
    }
    note = "Pairs with a plan: of random pairs that share no grasp. Solved: of the pairs that were planned for."
    return tables.listing("Meshes", [row for row in rows if "faces" in row], columns, note)


def _missed(rows: list[Row]) -> Table:
    """Return the pairs that the arm's energy does not solve, or with more regrasps."""
    missed = [
        row
        for row in rows
        if row.get("planner") == "arm energy" and (not row["solved"] or row["num_regrasps"] > row["minimum"])
    ]
    columns: dict[str, tables.Value] = {
        "where": "part",
        "pair": "pair",
        "status": "status",
        "N": "num_regrasps",
        "least N": "minimum",
        "time [s]": lambda row: round(row["seconds"], 2),
    }
    return tables.listing("Pairs that the energy of the arm missed, or solved with a larger N", missed, columns)


def _refused(rows: list[Row]) -> Table:
    """Return what could not be measured at all, and why."""
    wrong = [
        {**row, "why": row.get("error") or row.get("reason") or f"exit code {row['exit']}"}
        for row in rows
        if row.get("error") or row.get("reason") or row.get("exit")
    ]
    return tables.listing("Not planned", wrong, {"where": "part", "what": "object", "why": "why"})
