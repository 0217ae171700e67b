"""Layouts that viewers open beside a recording."""
