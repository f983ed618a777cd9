"""Recordings for Rerun: written from the RunLog's rows while a run goes, or afterwards from the log.

The only room that imports rerun. Importing this front door costs nothing: `recorder` and `rebuild` load rerun,
`viewer` does not.
"""
