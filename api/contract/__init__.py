"""The contract: OpenAPI, its examples, problem codes, documentation made from the code."""
