# A container with pcwlad-geo that runs as nobody in particular and in a read-only file system:
#     docker build -t pcwlad-geo .
#     docker run --rm --read-only --tmpfs /tmp --user "$(id -u):$(id -g)" -v "$PWD:/data" pcwlad-geo register a.tif b.tif
# docs/installing.md says how it is tested, and compose.yaml makes a dask cluster of it.
ARG PYTHON=3.13

FROM python:${PYTHON}-slim AS wheel
COPY . /source
RUN python -m pip install --no-cache-dir build
RUN python -m build --wheel --outdir /dist /source

FROM python:${PYTHON}-slim
LABEL org.opencontainers.image.title="pcwlad-geo" \
      org.opencontainers.image.description="Sub-pixel registration of multimodal rasters" \
      org.opencontainers.image.licenses="MIT"
# GDAL in the wheel of rasterio needs libexpat, which the slim images are without
RUN apt-get update && apt-get install -y --no-install-recommends libexpat1 && rm -rf /var/lib/apt/lists/*
COPY --from=wheel /dist /dist
COPY constraints.txt /dist/constraints.txt
RUN python -m venv /opt/pcwlad-geo
RUN /opt/pcwlad-geo/bin/pip install --no-cache-dir -c /dist/constraints.txt "$(echo /dist/*.whl)[dask]"
COPY --chmod=755 container/entrypoint /usr/local/bin/entrypoint
ENV HOME=/tmp \
    PATH=/opt/pcwlad-geo/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1
RUN useradd --no-create-home --uid 1000 pcwlad && install -d -o pcwlad -g pcwlad /data
USER pcwlad
# a library of the system that is missing shows while the image is built
RUN pcwlad-geo demo /tmp/demo --progress none && rm -rf /tmp/demo
WORKDIR /data
ENTRYPOINT ["entrypoint"]
CMD ["--help"]
