"""Physical channel, equations (1) to (6) of Nagura et al. 2010: LED patterns -> camera frames and separate truth.

exposure (PWM slots within the shutter) -> scene and motion (pinhole, vehicle) -> background -> optics (panel, disc,
lobe, blur, pixels) -> sensor (EMVA 1288) -> transfer (lost and repeated frames).
"""
