"""Estimators and searches: from friction records to a fitted law."""
