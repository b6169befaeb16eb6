"""Bodies of requests: read within limits, parsed as forms or JSON, their errors brought to the fields."""
