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

    A model of an object is found by `id`, which means for exactly this scene; the energy of an arm by its `ArmKey`.
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
        return ModelKey(
            id=content_hash("model", FORMAT, body.fingerprint(), workcell.fingerprint())[:32],
            object=body.fingerprint(),
            **asdict(ArmKey.of(workcell)),
            surroundings=surroundings(workcell),
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


@dataclass(frozen=True)
class ArmKey:
    """A hash of each part of an arm that its energy belongs to: what it says of another arm is meaningless.

    Where objects may stand and what is around them are free, since an energy ranks grasps, and exact checks decide.
    """

    robot: str
    mounting: str
    end_effector: str

    @staticmethod
    def of(workcell: Workcell) -> ArmKey:
        """Return the key of the arm in `workcell`."""
        arm = workcell.arm
        return ArmKey(arm.robot.fingerprint(), content_hash(arm.T_world_base), arm.end_effector.fingerprint())

    @property
    def id(self) -> str:
        """One hash of all parts."""
        return content_hash("arm", FORMAT, self.robot, self.mounting, self.end_effector)[:32]

    def differing(self, card: dict[str, Any]) -> list[str]:
        """Return the parts in which the energy with the model card `card` belongs to another arm, or does not say."""
        known = card.get("arm")
        parts = asdict(self).items()
        return [n.replace("_", "-") for n, value in parts if not isinstance(known, dict) or known.get(n) != value]


def surroundings(workcell: Workcell) -> str:
    """Return a hash of the supports and obstacles that `workcell` was loaded with."""
    workcell = workcell.as_loaded
    fixed = (*(shape for support in workcell.supports for shape in support.shapes), *workcell.obstacles)
    return content_hash([shape_parts(shape) for shape in fixed])
