"""What a model was made for, part by part, so that messages can name the part of a scene that it does not fit."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import shape_parts
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene import Workcell

FORMAT = 1


@dataclass(frozen=True)
class ModelKey:
    """A hash of each part of a scene that decides which grasps are feasible, and `id`, one of all.

    An energy belongs to its arm (`robot`, `mounting`, `end_effector`): what it says of another is meaningless. The
    other parts say in which scene it was labelled. Today a model is found by `id`, which means for exactly this scene.
    """

    id: str
    object: str
    robot: str
    mounting: str
    end_effector: str
    surroundings: str
    workspace: str
    clearance: str

    @staticmethod
    def of(body: ObjectModel, workcell: Workcell) -> ModelKey:
        """Return the key of models of `body` in `workcell`; obstacles that were put in afterwards are not part of it.

        An energy ranks grasps, and exact checks decide: what stands in the way only now needs no other model.
        """
        workcell = workcell.as_loaded
        fixed = (*(support.shape for support in workcell.supports), *workcell.obstacles)
        return ModelKey(
            id=content_hash("model", FORMAT, body.fingerprint(), workcell.fingerprint())[:32],
            object=body.fingerprint(),
            robot=workcell.arm.robot.fingerprint(),
            mounting=content_hash(workcell.arm.T_world_base),
            end_effector=workcell.arm.end_effector.fingerprint(),
            surroundings=content_hash([shape_parts(shape) for shape in fixed]),
            workspace=content_hash(workcell.bounds.array),
            clearance=content_hash(np.array(list(vars(workcell.clearance).values()))),
        )

    def parts(self) -> dict[str, str]:
        """Return all but `id`, for a report."""
        return {name: value for name, value in asdict(self).items() if name != "id"}

    def differing(self, report: dict[str, Any]) -> list[str]:
        """Return the parts in which the model of `report` was made for something else; older reports know none."""
        made_for = report.get("made_for")
        known = made_for if isinstance(made_for, dict) else {}
        return [name.replace("_", "-") for name, value in self.parts().items() if known.get(name, value) != value]
