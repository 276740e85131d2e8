"""Grasps that move on the object, where the set holds none that two poses share."""
