"""Adam (Kingma & Ba 2015) and the log-linear schedule, in 50-digit arithmetic; settings are float64 values, taken exactly."""

from mpmath import mp, mpf


def adam(start, gradients, rates, beta1, beta2, epsilon):
    """Parameters after each step: theta -= rate * m^ / (sqrt(v^) + epsilon), m^ and v^ with bias correction."""
    beta1, beta2, epsilon = mpf(beta1), mpf(beta2), mpf(epsilon)
    theta = [mpf(float(x)) for x in start]
    m, v = [mpf(0)] * len(theta), [mpf(0)] * len(theta)
    trajectory = []
    for step, (row, rate) in enumerate(zip(gradients, rates), 1):
        for k, gradient in enumerate(row):
            g = mpf(float(gradient))
            m[k] = beta1 * m[k] + (1 - beta1) * g
            v[k] = beta2 * v[k] + (1 - beta2) * g * g
            m_hat, v_hat = m[k] / (1 - beta1**step), v[k] / (1 - beta2**step)
            theta[k] -= mpf(float(rate)) * m_hat / (mp.sqrt(v_hat) + epsilon)
        trajectory.append(list(theta))
    return trajectory


def rate(step, first, last, length):
    """first at step 0, last at `length` and after it, log-linear between; 0 if either is 0."""
    if first == 0 or last == 0:
        return mpf(0)
    t = min(mpf(step) / length, mpf(1))
    return mp.exp((1 - t) * mp.log(mpf(first)) + t * mp.log(mpf(last)))
