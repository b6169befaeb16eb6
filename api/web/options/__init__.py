"""Options of a form that sends captures, and the sample capture."""
