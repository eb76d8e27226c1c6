# docker build -t hesr . && docker run --rm -v "$PWD:/work" hesr run my_study.toml
# docker build --target check . tries the image.
FROM python:3.13-slim AS build
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir build==1.6.1 && python -m build --wheel

FROM python:3.13-slim AS hesr
COPY --from=build /source/dist/*.whl /tmp/
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir /tmp/*.whl && rm /tmp/*.whl && useradd --create-home --uid 1000 hesr && install -d -o hesr /work
USER 1000
WORKDIR /work
ENTRYPOINT ["hesr"]

FROM hesr AS check
WORKDIR /home/hesr
RUN hesr run --quick

FROM hesr
