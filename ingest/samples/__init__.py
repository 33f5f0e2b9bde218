"""Sample parts that come with breplake: some dozens of mechanical parts as STEP files."""
