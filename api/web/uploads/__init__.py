"""Uploads: files in pieces, by tus 1.0."""
