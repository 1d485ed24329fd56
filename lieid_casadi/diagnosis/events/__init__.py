"""Stretches of recordings that say nothing about the arm: contact, faults, joints at rest."""
