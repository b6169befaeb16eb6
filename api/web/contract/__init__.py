"""Contract of the web API: OpenAPI with examples, problem codes, and the pages that are made from the code."""
