"""Formats of other programs: what a robot, a planner or a simulator takes from a plan or a motion."""
