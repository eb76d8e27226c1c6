import java.io.File;
import java.io.PrintWriter;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.List;
import no.ntnu.ihb.fmi4j.importer.fmi2.CoSimulationFmu;
import no.ntnu.ihb.fmi4j.importer.fmi2.CoSimulationSlave;
import no.ntnu.ihb.fmi4j.importer.fmi2.Fmu;
import no.ntnu.ihb.fmi4j.modeldescription.variables.Causality;
import no.ntnu.ihb.fmi4j.modeldescription.variables.ModelVariables;
import no.ntnu.ihb.fmi4j.modeldescription.variables.TypedScalarVariable;

/**
 * One FMU for co-simulation, run by FMI4j:
 *
 * <pre>java Host FMU INPUTS.tsv RESULT.tsv STOP STEP [NAME=VALUE...]</pre>
 *
 * The inputs of each row are set at its time and hold over the step. All outputs of type Real are
 * written at every step.
 */
public final class Host {
    private final CoSimulationSlave slave;
    private final ModelVariables variables;

    private Host(CoSimulationSlave slave) {
        this.slave = slave;
        this.variables = slave.getModelDescription().getModelVariables();
    }

    public static void main(String[] arguments) throws Exception {
        double stop = Double.parseDouble(arguments[3]);
        double step = Double.parseDouble(arguments[4]);
        List<String[]> rows = new ArrayList<>();
        for (String line : Files.readAllLines(Path.of(arguments[1]))) {
            rows.add(line.split("\t"));
        }
        try (CoSimulationFmu fmu = Fmu.from(new File(arguments[0])).asCoSimulationFmu();
                CoSimulationSlave slave = fmu.newInstance();
                PrintWriter result = new PrintWriter(arguments[2])) {
            Host host = new Host(slave);
            require(slave.setupExperiment(0.0, stop, 0.0), "fmi2SetupExperiment");
            for (String pair : Arrays.copyOfRange(arguments, 5, arguments.length)) {
                host.start(pair);
            }
            require(slave.enterInitializationMode(), "fmi2EnterInitializationMode");
            host.run(rows, step, (int) Math.round(stop / step), result);
        }
    }

    private void run(List<String[]> rows, double step, int steps, PrintWriter result) {
        String[] named = Arrays.copyOfRange(rows.get(0), 1, rows.get(0).length);
        long[] inputs = variables.getValueReferences(named);
        List<String> names = new ArrayList<>();
        for (TypedScalarVariable<?> variable : variables.getByCausality(Causality.OUTPUT)) {
            if (variables.getReals().contains(variable)) {
                names.add(variable.getName());
            }
        }
        long[] outputs = variables.getValueReferences(names.toArray(new String[0]));
        result.println("time\t" + String.join("\t", names));
        set(inputs, rows.get(1));
        require(slave.exitInitializationMode(), "fmi2ExitInitializationMode");
        for (int k = 0; k <= steps; k++) {
            if (k > 0) {
                set(inputs, rows.get(k));
                require(slave.doStep((k - 1) * step, step), "fmi2DoStep");
            }
            double[] values = new double[outputs.length];
            require(slave.readReal(outputs, values).isOK(), "fmi2GetReal");
            StringBuilder line = new StringBuilder(Double.toString(k * step));
            for (double value : values) {
                line.append('\t').append(value);
            }
            result.println(line);
        }
        require(slave.terminate(), "fmi2Terminate");
    }

    /** Sets the inputs to a row, whose first entry is its time. */
    private void set(long[] inputs, String[] row) {
        if (inputs.length > 0) {
            double[] values = new double[inputs.length];
            for (int i = 0; i < inputs.length; i++) {
                values[i] = Double.parseDouble(row[i + 1]);
            }
            require(slave.writeReal(inputs, values).isOK(), "fmi2SetReal");
        }
    }

    private void start(String pair) {
        int split = pair.lastIndexOf('=');
        TypedScalarVariable<?> variable = variables.getByName(pair.substring(0, split));
        double value = Double.parseDouble(pair.substring(split + 1));
        long[] reference = {variable.getValueReference()};
        boolean done =
                variables.getReals().contains(variable)
                        ? slave.writeReal(reference, new double[] {value}).isOK()
                        : slave.writeInteger(reference, new int[] {(int) value}).isOK();
        require(done, "setting " + pair);
    }

    private static void require(boolean done, String what) {
        if (!done) {
            throw new IllegalStateException(what + " failed");
        }
    }
}
