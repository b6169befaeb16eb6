"""Running a reconstruction: the plan, its stages, the executor of one machine, live captures, the check of a session.

Imports from every room of the pipeline; the rooms import nothing from here.
"""
