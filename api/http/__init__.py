"""HTTP around the routes: middleware, connections, limits, ranges."""
