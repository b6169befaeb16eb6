"""Rights to reach records: keys of tenants, browsers that have shown one, links."""
