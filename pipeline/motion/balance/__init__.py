"""Balance: centre of mass, momentum, base of support."""
