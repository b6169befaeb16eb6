"""Force plates of a laboratory, and the clock of its file by contacts and vertical force."""
