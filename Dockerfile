# The workflow with its environment, installed by hash from environment-pip.lock.
#
#   docker build --tag virtual-phantom .
#   docker run --rm --volume "$PWD:/work" virtual-phantom --cores 2 --configfile my.yaml
#
# The folder that is mounted holds your configuration and gets the results.
FROM debian:bookworm-slim

# pyradiomics is built from source, and the projector's kernels are compiled when they are first used.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends gcc libc6-dev make python3 python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/virtual-phantom
COPY . .
RUN make setup

# Any user may run it: what is compiled goes where everybody may write.
# hadolint ignore=DL3059
RUN mkdir -m 1777 /cache
ENV PATH="/opt/virtual-phantom/.venv/bin:$PATH" \
    XDG_CACHE_HOME=/cache \
    NUMBA_CACHE_DIR=/cache/numba
WORKDIR /work
ENTRYPOINT ["snakemake", "--snakefile", "/opt/virtual-phantom/workflow/Snakefile"]
CMD ["--cores", "2"]
