"""Videos for players: formats that browsers play, and proxies of the others."""
