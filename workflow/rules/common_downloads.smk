"""Files on the web as inputs, and which of those that a configuration names are not here yet."""

from virtual_phantom.io.published import check_listed, named_by, read_published

ABDOMEN_CT = resource("abdomen_ct.csv")


def reachable(url, advice):
    """A file on the web as an input; where it cannot be had, one line instead of the plugin's traceback.

    advice   what to do where there is no network
    """
    import requests

    try:
        requests.head(url, timeout=20, allow_redirects=True).raise_for_status()
    except requests.RequestException as error:
        reason = "no connection" if error.response is None else error.response.reason
        sys.exit(f"Error: {url} cannot be fetched ({reason}); {advice}")
    return storage.published(url)


def sinogram(disc):
    """A sinogram of the Helsinki Tomography Challenge 2022 as an input."""
    url = f"{PLAN.config['downloads']['htc2022']}/htc2022_{disc}_full.mat"
    return reachable(
        url,
        "where there is a network, download it there and run virtual-phantom-import htc2022 "
        f"{os.path.basename(url)} {RESULTS}/downloads/htc2022_{disc}",
    )


def abdomen_ct(wildcards):
    """What is not here yet of the clinical CT, as inputs."""
    folder = PLAN.config["downloads"]["abdomen_ct"]
    advice = (
        f"where there is a network, download the files that {ABDOMEN_CT} lists: those of {folder}/example_ct_dicom go to "
        "downloads/abdomen_ct/dicom, example_seg_dicom.nii.gz beside it becomes downloads/abdomen_ct/labels.nii.gz"
    )
    return [reachable(f"{folder}/{file.source}", advice) for file in ABSENT]


def layout_file():
    """The layout of the synthetic phantom."""
    return PLAN.config["phantom"]["layout"] or resource("phantom.yaml")


def phantom_files():
    """Paths of the configuration that the phantom is made from, files and folders."""
    settings = PLAN.config["phantom"]
    if settings["source"] == "synthetic":
        return [layout_file()]
    ct = settings["ct"]
    regions = [ct.get("labels"), *(roi.get("file") for roi in ct["rois"])]
    return [ct["image"], *dict.fromkeys(filter(None, regions))]


try:
    PUBLISHED = named_by(phantom_files(), read_published(ABDOMEN_CT))
    ABSENT = [file for file in PUBLISHED if not os.path.exists(file.path)]
    if workflow.is_main_process:
        for file in PUBLISHED:
            if file not in ABSENT:
                check_listed(
                    file.path,
                    file.sha256,
                    ABDOMEN_CT,
                    "delete it, and it is fetched again; or name a file of your own under phantom.ct",
                )
except InputError as error:
    sys.exit(f"Error: {error}")
