"""What a printed robot is made of, as numbers: strips and masses, springs, and how uncertain each is.

No robot, no motion and no heat is computed here (`eldir.built`).
"""
