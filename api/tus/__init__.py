"""Storage of resumable uploads (tus 1.0); their routes are in ``api.routes.uploads``."""
