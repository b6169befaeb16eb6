"""Problem codes of the API's responses, and the page with all codes, which is made from their declarations."""
