"""Jobs and their files: the records, the database, repositories, stored files, backup.

Imports from the pipeline only what knows no science; neither Celery, but for the bell that it rings, nor HTTP.
"""
