"""Web API: the application, authentication, HTTP, the contract, and a folder a resource.

Imports ``worker.store``, and from the pipeline only what knows no science.
"""
