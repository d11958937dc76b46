"""Batch estimators: from a problem and starts to a point in parameter space.

Enters: a model or "auto", a `Dataset`, and options (`FitOptions`).
Leaves: a `FitResult` with status and notes, or a `Comparison` of models by cross-validation.
Open first: `fit_model.py`, the steps of one fit; `comparison/model_search.py`, the order in which a comparison tries models.
"""
