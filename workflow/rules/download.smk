# Published recordings, fetched where there is a network. docs/recordings.md says what they are.
storage published:
    provider="http",
    retries=1,


def published(name, url):
    """A file on the web as an input; where it cannot be had, one line instead of the plugin's traceback."""
    import requests

    try:
        requests.head(url, timeout=20, allow_redirects=True).raise_for_status()
    except requests.RequestException as error:
        reason = "no connection" if error.response is None else error.response.reason
        sys.exit(
            f"Error: {url} cannot be fetched ({reason}); where there is a network, download it there and run "
            f"python workflow/scripts/import_recording.py htc2022 {os.path.basename(url)} {name}"
        )
    return storage.published(url)


rule download_htc2022:
    """One sinogram of the Helsinki Tomography Challenge 2022 as a recording of projections."""
    input:
        lambda wildcards: published(
            f"{RESULTS}/downloads/htc2022_{wildcards.disc}",
            f"{PLAN.config['downloads']['htc2022']}/htc2022_{wildcards.disc}_full.mat",
        ),
    output:
        directory(f"{RESULTS}/downloads/htc2022_{{disc}}"),
    log:
        f"{RESULTS}/logs/download_htc2022/{{disc}}.log",
    wildcard_constraints:
        disc="solid_disc|t[a-d]",
    resources:
        mem_mb=1000,
        runtime=30,
    script:
        "../scripts/import_htc2022.py"
