"""Fields of KubeRay's custom resources that the manifest may use, and their types.

Facts of "KubeRay CRD API reference", docs.ray.io, generated for KubeRay 1.6.2. Fields that are not in it are
refused, as the API server refuses them.
"""

from typing import Any

KUBERAY = "1.6.2"
TEXT, WHOLE, YES_OR_NO = {"type": "string"}, {"type": "integer", "minimum": 0}, {"type": "boolean"}
ANY_OBJECT: dict[str, Any] = {"type": "object"}
LIST = {"type": "array"}
TEXTS = {"type": "object", "additionalProperties": TEXT}


def record(required: str = "", /, **fields: Any) -> dict[str, Any]:
    options = {"required": required.split(), "additionalProperties": False}
    return {"type": "object", "properties": fields, **options}


def one_of(*values: str) -> dict[str, Any]:
    return {"enum": list(values)}


QUANTITIES = {"type": "object", "additionalProperties": {"type": ["string", "integer"]}}

CONTAINER = record(
    "name image",
    name=TEXT, image=TEXT, imagePullPolicy=one_of("Always", "IfNotPresent", "Never"),
    command=LIST, args=LIST, env=LIST, envFrom=LIST, ports=LIST, lifecycle=ANY_OBJECT,
    resources=record(requests=QUANTITIES, limits=QUANTITIES), securityContext=ANY_OBJECT,
    volumeMounts={
        "type": "array",
        "items": record("name mountPath", name=TEXT, mountPath=TEXT, subPath=TEXT, readOnly=YES_OR_NO),
    },
)  # fmt: skip

POD = record(
    "spec",
    metadata=ANY_OBJECT,
    spec=record(
        "containers",
        containers={"type": "array", "items": CONTAINER, "minItems": 1},
        initContainers={"type": "array", "items": CONTAINER},
        volumes={
            "type": "array",
            "items": record(
                "name", name=TEXT, persistentVolumeClaim=ANY_OBJECT, emptyDir=ANY_OBJECT, secret=ANY_OBJECT
            ),
        },
        securityContext=ANY_OBJECT, serviceAccountName=TEXT, nodeSelector=TEXTS, tolerations=LIST,
        affinity=ANY_OBJECT, imagePullSecrets=LIST, terminationGracePeriodSeconds=WHOLE,
        restartPolicy=one_of("Always", "OnFailure", "Never"),
    ),
)  # fmt: skip

HEAD = record(
    "template",
    template=POD, rayStartParams=TEXTS, headService=ANY_OBJECT, enableIngress=YES_OR_NO, labels=TEXTS,
    resources=QUANTITIES, serviceType=one_of("ClusterIP", "NodePort", "LoadBalancer"),
)  # fmt: skip

WORKERS = record(
    "groupName template",
    groupName=TEXT, template=POD, rayStartParams=TEXTS, replicas=WHOLE, minReplicas=WHOLE, maxReplicas=WHOLE,
    numOfHosts=WHOLE, idleTimeoutSeconds=WHOLE, suspend=YES_OR_NO, scaleStrategy=ANY_OBJECT, labels=TEXTS,
    resources=QUANTITIES,
)  # fmt: skip

CLUSTER = record(
    "headGroupSpec",
    headGroupSpec=HEAD, workerGroupSpecs={"type": "array", "items": WORKERS}, rayVersion=TEXT,
    enableInTreeAutoscaling=YES_OR_NO, suspend=YES_OR_NO, managedBy=TEXT, headServiceAnnotations=TEXTS,
    authOptions=record(
        mode=one_of("disabled", "token"), secretName=TEXT, enableK8sTokenAuth=YES_OR_NO
    ),
    autoscalerOptions=record(
        resources=ANY_OBJECT, image=TEXT, imagePullPolicy=TEXT, securityContext=ANY_OBJECT,
        idleTimeoutSeconds=WHOLE, upscalingMode=one_of("Default", "Aggressive", "Conservative"),
        version=one_of("v1", "v2"), env=LIST, envFrom=LIST,
        volumeMounts=LIST,
    ),
    gcsFaultToleranceOptions=ANY_OBJECT, upgradeStrategy=ANY_OBJECT,
)  # fmt: skip

JOB = record(
    "apiVersion kind metadata spec",
    apiVersion={"const": "ray.io/v1"},
    kind={"const": "RayJob"},
    metadata=ANY_OBJECT,
    spec=record(
        "entrypoint rayClusterSpec",
        activeDeadlineSeconds=WHOLE, backoffLimit=WHOLE, rayClusterSpec=CLUSTER, submitterPodTemplate=POD,
        metadata=TEXTS, clusterSelector=TEXTS, submitterConfig=record(backoffLimit=WHOLE), managedBy=TEXT,
        deletionStrategy=ANY_OBJECT, entrypoint=TEXT, runtimeEnvYAML=TEXT, jobId=TEXT,
        submissionMode=one_of("K8sJobMode", "HTTPMode", "InteractiveMode", "SidecarMode"),
        entrypointResources=TEXT, entrypointNumCpus={"type": "number"}, entrypointNumGpus={"type": "number"},
        ttlSecondsAfterFinished=WHOLE, shutdownAfterJobFinishes=YES_OR_NO, suspend=YES_OR_NO,
        preRunningDeadlineSeconds=WHOLE,
    ),
)  # fmt: skip
