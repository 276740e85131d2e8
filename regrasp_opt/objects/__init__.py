"""Objects: built-in solids and any mesh file, checked or repaired, with their stable placements."""

from regrasp_opt.objects.builtin import OBJECT_NAMES
from regrasp_opt.objects.model import ObjectModel, load_object
from regrasp_opt.objects.placements import Placement, stable_placements

__all__ = ["OBJECT_NAMES", "ObjectModel", "Placement", "load_object", "stable_placements"]
