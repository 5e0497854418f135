"""report.html: its pictures, its table of suspects, and what to do next."""
