"""Error model of results, in recordings and streams: the variance of a result is the sum of these terms.

| term | module | what it is the variance of |
|---|---|---|
| noise | `image_noise` | displacements by image noise in two or three frames |
| curvature | `curvature` | positions by displacement that is curved within a window |
| onset | `onset_time` | displacements by the uncertain time of the onset of contact |
| overlap | `overlap` | gradients by noise that neighbours share in overlapping windows |
| smoothing | `smoothing` | fields at points, and medians, by the finite gauge length |
| border, coverage, entry | `medians` | medians by the uncertain border, by unknown skin, by advected skin |

The first four give the covariance of the displacement of each point, which the fits of the fields propagate.
"""
