"""The case file: schema, histories, and identity of cases."""
