"""From a plan to what a robot executes: the joint problem and free grasps."""
