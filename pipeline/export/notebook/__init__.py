"""Takes in notebooks: named arrays, data frames, tables and plots. Imports records, angles and optional packages."""
