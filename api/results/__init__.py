"""Result files of jobs."""
