"""Answers of the report to the questions of a pilot, in sentences."""
