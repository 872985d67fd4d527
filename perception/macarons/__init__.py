"""MACARONS (Guédon et al., CVPR 2023): depth, occupancy and coverage gain learnt from RGB pictures and poses.

Written anew from a description of the published method; what differs is listed in docs/macarons.md. Lengths inside are
in units of the sensing range, so that one set of weights serves any scale.
"""
