"""Shapes and meshes, and the one conversion of both to Coal."""
