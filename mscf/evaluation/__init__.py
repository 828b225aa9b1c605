"""Measuring trackers: data sets, metrics and protocols."""
