"""A human body for skeletons: installed from its package, shaped by a person's bones, and moved by the joints."""
