"""Joint angles of a fitted skeleton by the definitions of the International Society of Biomechanics."""
