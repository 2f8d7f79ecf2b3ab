"""The hidden-effect study: does `diagnose` name what was hidden, and hold its tongue where it should?"""
