"""Tables as loggers, spreadsheets and people write them: one reader for every command."""
