"""HDF5 of DeepLabCut and SLEAP: opened in a child process with limits, of which only names and points come back."""
