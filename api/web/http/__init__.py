"""HTTP below the routes: server, connections, middleware, rate limits, byte ranges, entity tags."""
