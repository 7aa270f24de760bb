"""The case: its schema, its histories, and what tells two of them apart."""
