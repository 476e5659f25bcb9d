"""TIGRE's photon and electronic noise, for given draws."""

from mpmath import mp, mpf


def expected(projection, peak, photons):
    """Photons that a pixel expects; the stack's largest projection `peak` is a transmission of 1/e."""
    return mpf(photons) * mp.exp(-projection / peak)


def noisy(peak, count, normal, photons, sigma, floor):
    """max(0, -ln(max(count + sigma normal, floor)/I0) p_max)"""
    reading = max(mpf(float(count)) + mpf(sigma) * mpf(float(normal)), mpf(floor))
    return max(mpf(0), -mp.log(reading / mpf(photons)) * mpf(float(peak)))
