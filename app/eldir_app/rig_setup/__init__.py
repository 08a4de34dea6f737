"""The guided setup of a rig, `eldir rig setup`: a dialogue that writes the rig file answer by answer.

Springs are warmed by `eldir_app.switching_checks`, not here.
"""
