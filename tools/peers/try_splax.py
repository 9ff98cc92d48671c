"""splax (JAX and Warp) on the processor: its message, and what comes out when its graphs are turned off. See README.md."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import warp


def main() -> None:
    import splax

    count = 2000
    random = np.random.default_rng(0)
    parameters = (
        jnp.array(0.5 * random.normal(size=(count, 3)), jnp.float32),
        jnp.full((count, 3), -3.0),
        jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (count, 1)),
        jnp.full((count, 1, 3), 0.3),
        jnp.zeros(count),
    )
    view = jnp.eye(4).at[2, 3].set(4.0)

    def render(*parameters):
        camera = dict(viewmat=view, background=jnp.zeros(3), img_shape=(120, 160), f=(150.0, 150.0))
        return splax.render(*parameters, **camera)[0]

    pictures = [np.asarray(render(*parameters)) for _ in range(3)]
    finite = all(np.isfinite(picture).all() for picture in pictures)
    same = all((picture == pictures[0]).all() for picture in pictures)
    print(f"three pictures of one scene: finite {finite}, the same {same}, means {[float(p.mean()) for p in pictures]}")


if __name__ == "__main__":
    import sys

    if sys.argv[1:] == ["--without-graphs"]:
        modes = warp.JaxCallableGraphMode
        warp.JaxCallableGraphMode = types.SimpleNamespace(NONE=modes.NONE, WARP=modes.NONE, JAX=modes.NONE)
    try:
        main()
    except jax.errors.JaxRuntimeError as error:
        sys.exit(f"splax: {error}")
