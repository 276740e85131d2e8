"""The joint problem: poses, grasps and configurations of a plan together, for time, clearance or manipulability."""
