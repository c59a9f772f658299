"""The pose between two images of different modality: any rotation, scale and shift, and some shear.

`search` finds it by the structure that both show, and `grey_search` goes on by their grey values.
"""
