"""Engine of reconstructions: what a stage is, the plan of a job, outputs and their keys, the executor of one machine.

``plan``, ``stage`` and ``code`` need the standard library only, so that the web API can plan jobs.
"""
