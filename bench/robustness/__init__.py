"""Does ingest survive what it is made to survive: broken files, kills."""
