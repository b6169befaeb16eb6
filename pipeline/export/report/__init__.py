"""The report of a take: one file of HTML that needs no network."""
