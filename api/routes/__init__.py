"""Routes of the web API, a module for each resource."""
