"""Outputs of a live capture: each sends its people to other programs by a protocol, on a thread of its own.

``output`` has the interface, ``addresses`` the table of protocols, ``runner`` the threads. A protocol is a module with
a class, and a line of the table.
"""
