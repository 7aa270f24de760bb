"""The paper, reproduced: its inputs, the chain with its files, tables, figures and report."""
