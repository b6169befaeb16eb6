"""Files of pinned packages: found on the user's index, downloaded, checked and read; their code is never run."""
