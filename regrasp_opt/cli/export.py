"""`regrasp-opt export`."""

from __future__ import annotations

import json
import os
from pathlib import Path

from regrasp_opt.energy.export import EXPORTERS, SUFFIXES
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.errors import UnknownNameError
from regrasp_opt.planning.model_store import (
    REPORT_FILE,
    bundled_models,
    load_prepared_energy,
    load_prepared_grasps,
    read_report,
)


def run_export(model: Path, to: str, out: Path | None, *, as_json: bool) -> int:
    """Export the energy of a prepared model; return 0."""
    bundled = {folder.parent.name: folder.parent for folder in bundled_models().glob(f"*/{REPORT_FILE}")}
    folder = model if os.path.isdir(model) else bundled.get(str(model))
    if folder is None:
        raise UnknownNameError("model", str(model), bundled)
    energy = GraspEnergy(
        load_prepared_energy(folder, "default", read_report(folder)["key"]), load_prepared_grasps(folder)
    )
    path = out or Path(f"{folder.resolve().name}{SUFFIXES[to]}")
    EXPORTERS[to](energy, path)
    if as_json:
        print(json.dumps({"model": str(folder), "format": to, "grasps": len(energy), "path": str(path)}))
    else:
        print(f"written: {path}")
    return 0
