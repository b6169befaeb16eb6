"""What the science runs on: compilation of kernels, memory, child processes, files of packages."""
