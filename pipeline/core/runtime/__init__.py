"""Runtime support of the pipeline: compiled kernels, memory limits, child processes and files of packages."""
