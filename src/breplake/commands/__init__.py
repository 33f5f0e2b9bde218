"""The commands of ``breplake``. Each imports what it needs when it runs, so that help is quick."""
