"""Recordings that are no flight folders: logs, bags and videos, one file for each format."""
