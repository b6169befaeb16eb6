"""OpenSim: anatomical markers of people, a generic model scaled to each, and its inverse kinematics."""
