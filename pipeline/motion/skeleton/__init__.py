"""The articulated skeleton: joints, bones, rest pose, and motion made of rotations."""
