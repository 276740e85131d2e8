"""Verifiers with eyes of their own: MuJoCo's URDF import and collision engine, and readers that know the files alone.

``python -m tests.oracles PLAN_OR_MOTION.json ...`` verifies saved files. Nothing here imports the package, except for
the meshes of the built-in objects and the repair of meshes, which no file holds.
"""
