"""Whether a simulated walk can be believed: coils that would buckle, and slips that are left to chance.

Whether a robot falls or folds is in `eldir.built.walking`, whether it stands in `eldir.built.statics`.
"""
